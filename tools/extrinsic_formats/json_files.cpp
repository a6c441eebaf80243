#include <algorithm>
#include <map>
#include <nlohmann/json.hpp>

#include "extrinsic_formats/format_files.hpp"

namespace calib::formats {
namespace {

using nlohmann::json;

constexpr const char* ego = "ego";

/// `value[key]` as a list of `count` numbers; `what` names the place in the file.
Result<std::vector<double>> numbers_at(const TextFile& file, const json& value, const char* key, std::size_t count,
                                       const std::string& what) {
  const auto found = value.is_object() ? value.find(key) : value.end();
  if (found == value.end() || !found->is_array() || found->size() != count)
    return malformed(file, what + "." + key + ": needs a list of " + std::to_string(count) + " numbers");
  std::vector<double> numbers;
  for (const json& item : *found) {
    if (!item.is_number()) return malformed(file, what + "." + key + ": needs a list of numbers");
    numbers.push_back(item.get<double>());
    if (!(std::abs(numbers.back()) <= max_step_m))
      return malformed(file, what + "." + key + ": a number is beyond 1e7");
  }
  return numbers;
}

Result<std::string> text_at(const TextFile& file, const json& value, const char* key, const std::string& what) {
  const auto found = value.is_object() ? value.find(key) : value.end();
  if (found == value.end() || !found->is_string() || found->get_ref<const std::string&>().empty())
    return malformed(file, what + "." + key + ": needs text");
  return found->get<std::string>();
}

Result<json> parse(const TextFile& file) {
  json value = json::parse(file.text, nullptr, /*allow_exceptions=*/false);
  if (value.is_discarded()) return malformed(file, "is not JSON");
  return value;
}

Result<RigidTransform> matrix_at(const TextFile& file, const json& sensor_calib, const std::string& what) {
  const auto data = sensor_calib.is_object() ? sensor_calib.find("data") : sensor_calib.end();
  if (data == sensor_calib.end() || !data->is_array() || data->size() != 4)
    return malformed(file, what + ".data: needs 4 rows of 4 numbers");
  Eigen::Matrix4d M;
  for (std::size_t i = 0; i < 4; ++i) {
    const auto row = numbers_at(file, {{"row", (*data)[i]}}, "row", 4, what + ".data[" + std::to_string(i) + "]");
    if (!row) return propagate(row);
    M.row(static_cast<int>(i)) = Eigen::RowVector4d(row->data());
  }
  if (M.row(3) != Eigen::RowVector4d(0, 0, 0, 1)) return malformed(file, what + ".data: needs 0, 0, 0, 1 as last row");
  const auto T = transform_from_matrix({M(0, 3), M(1, 3), M(2, 3)}, M.topLeftCorner<3, 3>());
  if (!T) return malformed(file, what + ".data: " + T.error().context);
  return T;
}

/// The transform of points of `sensor_name` into `target_sensor_name`.
Result<FrameEdge> read_relation(const TextFile& file, const std::string& key, const json& value) {
  const auto from = text_at(file, value, "sensor_name", key), to = text_at(file, value, "target_sensor_name", key);
  if (!from) return propagate(from);
  if (!to) return propagate(to);
  const auto param = value.find("param");
  if (param == value.end() || !param->is_object() || !param->contains("sensor_calib"))
    return malformed(file, key + ".param.sensor_calib: missing");
  const auto T = matrix_at(file, (*param)["sensor_calib"], key + ".param.sensor_calib");
  if (!T) return propagate(T);
  return FrameEdge{*to, *from, *T, file.name};
}

struct SensorRow {
  std::string token, sensor_token;
  bool is_camera;
};

Result<void> add_calibrated_sensor(const TextFile& file, const json& row, const std::string& what, Frames& frames,
                                   std::vector<SensorRow>& rows) {
  const auto token = text_at(file, row, "token", what), sensor_token = text_at(file, row, "sensor_token", what);
  if (!token) return propagate(token);
  if (!sensor_token) return propagate(sensor_token);
  const auto t = numbers_at(file, row, "translation", 3, what), wxyz = numbers_at(file, row, "rotation", 4, what);
  if (!t) return propagate(t);
  if (!wxyz) return propagate(wxyz);
  const auto& q = *wxyz;
  const auto T = make_transform({(*t)[0], (*t)[1], (*t)[2]}, {q[1], q[2], q[3], q[0]});
  if (!T) return malformed(file, what + ".rotation: " + T.error().context);
  frames.edges.push_back({ego, *token, *T, file.name});
  const auto intrinsic = row.find("camera_intrinsic");
  rows.push_back({*token, *sensor_token, intrinsic != row.end() && intrinsic->is_array() && !intrinsic->empty()});
  return {};
}

/// Gives a channel as a name to its sensor, where there is one only.
void name_by_channel(const std::map<std::string, std::string>& channels, const std::vector<SensorRow>& rows,
                     Frames& frames) {
  std::map<std::string, std::vector<const SensorRow*>> of_channel;
  for (const SensorRow& row : rows)
    if (const auto found = channels.find(row.sensor_token); found != channels.end())
      of_channel[found->second].push_back(&row);
  for (const auto& [channel, sensors] : of_channel)
    if (sensors.size() == 1 && channel != sensors.front()->token)
      frames.edges.push_back({sensors.front()->token, channel, RigidTransform::Identity(), ""});
    else if (sensors.size() > 1)
      frames.remark = "; a channel that several calibrated sensors have, such as " + channel +
                      ", does not say which: name them by token";
}

}  // namespace

Result<Frames> read_opencalib(const std::vector<TextFile>& files) {
  Frames frames;
  for (const TextFile& file : files) {
    const auto value = parse(file);
    if (!value) return propagate(value);
    if (!value->is_object() || value->empty()) return malformed(file, "needs an object A-to-B-extrinsic");
    for (const auto& [key, relation] : value->items()) {
      const auto edge = read_relation(file, key, relation);
      if (!edge) return propagate(edge);
      frames.edges.push_back(*edge);
    }
  }
  if (frames.edges.size() == 1) frames.camera = frames.edges[0].parent, frames.lidar = frames.edges[0].child;
  return frames;
}

Result<Frames> read_nuscenes(const std::vector<TextFile>& files) {
  Frames frames;
  std::vector<SensorRow> rows;
  std::map<std::string, std::string> channels;
  for (const TextFile& file : files) {
    const auto value = parse(file);
    if (!value) return propagate(value);
    if (!value->is_array()) return malformed(file, "needs a list of sensors");
    for (std::size_t i = 0; i < value->size(); ++i) {
      const json& row = (*value)[i];
      const std::string what = "[" + std::to_string(i) + "]";
      if (row.is_object() && row.contains("channel")) {
        const auto token = text_at(file, row, "token", what), channel = text_at(file, row, "channel", what);
        if (!token) return propagate(token);
        if (!channel) return propagate(channel);
        channels[*token] = *channel;
      } else if (const auto added = add_calibrated_sensor(file, row, what, frames, rows); !added) {
        return propagate(added);
      }
    }
  }
  if (rows.size() == 2 && rows[0].is_camera != rows[1].is_camera) {
    frames.camera = rows[rows[0].is_camera ? 0 : 1].token;
    frames.lidar = rows[rows[0].is_camera ? 1 : 0].token;
  }
  name_by_channel(channels, rows, frames);
  return frames;
}

std::string opencalib_text(const FrameEdge& pose) {
  const std::string key = pose.child + "-to-" + pose.parent + "-extrinsic";
  const json value = {{"sensor_name", pose.child},
                      {"target_sensor_name", pose.parent},
                      {"device_type", "relational"},
                      {"param_type", "extrinsic"},
                      {"param",
                       {{"time_lag", 0},
                        {"sensor_calib",
                         {{"rows", 4},
                          {"cols", 4},
                          {"type", 6},
                          {"continuous", true},
                          {"data", matrix_rows(pose.T_parent_child, 4)}}}}}};
  return json{{key, value}}.dump(2) + '\n';
}

std::string nuscenes_text(const std::vector<FrameEdge>& poses) {
  json rows = json::array();
  for (const FrameEdge& pose : poses) {
    const auto q = quaternion_xyzw(pose.T_parent_child);
    rows.push_back({{"token", pose.child},
                    {"sensor_token", pose.child},
                    {"translation", translation_m(pose.T_parent_child)},
                    {"rotation", {q[3], q[0], q[1], q[2]}},
                    {"camera_intrinsic", json::array()}});
  }
  return rows.dump(2) + '\n';
}

}  // namespace calib::formats
