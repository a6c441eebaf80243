#include <algorithm>
#include <array>
#include <fstream>
#include <functional>
#include <map>
#include <nlohmann/json.hpp>
#include <set>

#include "dataset/recording.hpp"

namespace calib {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

/// What is wrong with a table; becomes an `Error` at the door of this file.
struct Malformed {
  ErrorCode code;
  std::string why;
};

/// The tables of nuScenes, arrays of objects. They are read row by row: some have gigabytes.
class Tables {
 public:
  explicit Tables(fs::path folder) : folder_(std::move(folder)) {}

  void for_each_row(const char* name, const std::function<void(const json&)>& take) const {
    const fs::path path = folder_ / name;
    std::error_code error;
    std::ifstream file;
    if (fs::is_regular_file(path, error)) file.open(path, std::ios::binary);
    if (!file.is_open()) throw Malformed{ErrorCode::calibration_missing, path.string() + " is not there"};
    const auto keep = [&](int depth, json::parse_event_t event, json& parsed) {
      const bool is_row = depth == 1 && event == json::parse_event_t::object_end;
      if (is_row) take(parsed);
      return !is_row;  // what was taken is forgotten
    };
    try {
      const json nothing = json::parse(file, keep);
    } catch (const json::exception& what) {
      throw Malformed{ErrorCode::calibration_malformed, path.string() + ": " + escape_control(what.what())};
    }
  }

 private:
  fs::path folder_;
};

/// `translation` and `rotation` (w, x, y, z) of a row.
RigidTransform pose_of(const json& row) {
  const auto t = row.at("translation").get<std::array<double, 3>>();
  const auto q = row.at("rotation").get<std::array<double, 4>>();
  const auto pose = make_transform(t, {q[1], q[2], q[3], q[0]});
  if (!pose) throw Malformed{ErrorCode::bad_transform, row.value("token", "a pose") + ": " + pose.error().context};
  return *pose;
}

struct Sensor {
  bool is_camera = false;
  RigidTransform T_ego_sensor;
  std::array<double, 4> intrinsics{};  // of a camera
};

/// One of the two files of a sample.
struct SampleFile {
  std::string file, ego_pose, sensor;  // the last two are tokens
  std::int64_t timestamp_us = 0;
  int width = 0, height = 0;
  [[nodiscard]] bool is_there() const { return !file.empty(); }
};
struct Sample {
  SampleFile image, cloud;
};

/// Calibrated sensors of the camera's and the LiDAR's channel, by token.
std::map<std::string, Sensor> read_sensors(const Tables& tables, const std::string& camera) {
  std::map<std::string, bool> wanted;  // token, and whether it is the camera
  std::set<std::string> cameras;
  std::size_t lidars = 0;
  tables.for_each_row("sensor.json", [&](const json& row) {
    const auto channel = row.at("channel").get<std::string>(), modality = row.at("modality").get<std::string>();
    if (modality == "camera") cameras.insert(channel);
    lidars += modality == "lidar";
    if (modality == "lidar" || (modality == "camera" && channel == camera))
      wanted[row.at("token").get<std::string>()] = modality == "camera";
  });
  if (!cameras.contains(camera)) {
    std::string names;
    for (const std::string& name : cameras) names += (names.empty() ? "" : ", ") + escape_control(name);
    throw Malformed{ErrorCode::recording_not_found, "there is no camera " + escape_control(camera) +
                                                        "; --camera is one of " + (names.empty() ? "none" : names)};
  }
  if (lidars != 1)
    throw Malformed{ErrorCode::recording_not_found,
                    "sensor.json has " + std::to_string(lidars) + " LiDARs, and one is read"};
  std::map<std::string, Sensor> sensors;
  tables.for_each_row("calibrated_sensor.json", [&](const json& row) {
    const auto of = wanted.find(row.at("sensor_token").get<std::string>());
    if (of == wanted.end()) return;
    Sensor sensor{of->second, pose_of(row), {}};
    if (sensor.is_camera) {
      const auto K = row.at("camera_intrinsic").get<std::array<std::array<double, 3>, 3>>();
      sensor.intrinsics = {K[0][0], K[1][1], K[0][2], K[1][2]};
    }
    sensors.emplace(row.at("token").get<std::string>(), sensor);
  });
  return sensors;
}

/// Tokens of the samples of a scene; all of them where the name is empty.
std::set<std::string> read_samples(const Tables& tables, const std::string& scene) {
  std::string scene_token, first, last;
  if (!scene.empty())
    tables.for_each_row("scene.json", [&](const json& row) {
      const auto name = row.at("name").get<std::string>();
      first = first.empty() ? name : std::min(first, name);
      last = std::max(last, name);
      if (name == scene) scene_token = row.at("token").get<std::string>();
    });
  if (!scene.empty() && scene_token.empty())
    throw Malformed{ErrorCode::recording_not_found, "there is no scene " + escape_control(scene) +
                                                        "; --drive is one of " + escape_control(first) + " .. " +
                                                        escape_control(last)};
  std::set<std::string> tokens;
  tables.for_each_row("sample.json", [&](const json& row) {
    if (scene.empty() || row.at("scene_token").get<std::string>() == scene_token)
      tokens.insert(row.at("token").get<std::string>());
  });
  return tokens;
}

std::map<std::string, Sample> read_files(const Tables& tables, const std::set<std::string>& samples,
                                         const std::map<std::string, Sensor>& sensors) {
  std::map<std::string, Sample> files;  // by the sample's token
  tables.for_each_row("sample_data.json", [&](const json& row) {
    if (!row.at("is_key_frame").get<bool>()) return;
    const auto sensor = sensors.find(row.at("calibrated_sensor_token").get<std::string>());
    const auto sample = row.at("sample_token").get<std::string>();
    if (sensor == sensors.end() || !samples.contains(sample)) return;
    SampleFile& file = sensor->second.is_camera ? files[sample].image : files[sample].cloud;
    file = {row.at("filename").get<std::string>(),
            row.at("ego_pose_token").get<std::string>(),
            sensor->first,
            row.at("timestamp").get<std::int64_t>(),
            0,
            0};
    if (!sensor->second.is_camera) return;
    file.width = row.at("width").get<int>();
    file.height = row.at("height").get<int>();
  });
  return files;
}

/// Poses of the vehicle that samples need. They are few of the table.
std::map<std::string, RigidTransform> read_poses(const Tables& tables, const std::map<std::string, Sample>& samples) {
  std::set<std::string> wanted;
  for (const auto& [token, sample] : samples) wanted.insert({sample.image.ego_pose, sample.cloud.ego_pose});
  std::map<std::string, RigidTransform> poses;
  tables.for_each_row("ego_pose.json", [&](const json& row) {
    auto token = row.at("token").get<std::string>();
    if (wanted.contains(token)) poses.emplace(std::move(token), pose_of(row));
  });
  return poses;
}

/// The folder of tables: `root` itself, or the only one in it.
fs::path find_tables(const fs::path& root) {
  std::error_code error;
  const auto has_tables = [&error](const fs::path& folder) { return fs::exists(folder / "sample_data.json", error); };
  if (has_tables(root)) return root;
  std::vector<fs::path> found;
  for (fs::directory_iterator entry(root, error), end; !error && entry != end; entry.increment(error))
    if (has_tables(entry->path())) found.push_back(entry->path());
  std::ranges::sort(found);
  if (found.size() == 1) return found.front();
  std::string names;
  for (const fs::path& folder : found) names += (names.empty() ? "" : ", ") + folder.string();
  throw Malformed{ErrorCode::recording_not_found,
                  found.empty()
                      ? root.string() + " has no folder of tables (v1.0-*/sample_data.json)"
                      : root.string() + " has several folders of tables; give one of " + names + " as --root"};
}

/// Samples of one vehicle, with one calibration.
struct Group {
  Sensor camera, lidar;
  int width = 0, height = 0;
  std::vector<Sample> samples;
};

std::map<std::vector<double>, Group> group_samples(const std::map<std::string, Sample>& samples,
                                                   const std::map<std::string, Sensor>& sensors,
                                                   std::vector<std::string>& lacks) {
  std::map<std::vector<double>, Group> groups;
  for (const auto& [token, sample] : samples) {
    if (!sample.image.is_there() || !sample.cloud.is_there()) {
      lacks.push_back((sample.image.is_there() ? "no cloud for " : "no image for ") + escape_control(token));
      continue;
    }
    const Sensor &camera = sensors.at(sample.image.sensor), &lidar = sensors.at(sample.cloud.sensor);
    std::vector<double> numbers(camera.intrinsics.begin(), camera.intrinsics.end());
    for (const Sensor* sensor : {&camera, &lidar})
      numbers.insert(numbers.end(), sensor->T_ego_sensor.data(), sensor->T_ego_sensor.data() + 16);
    numbers.insert(numbers.end(), {double(sample.image.width), double(sample.image.height)});
    groups.try_emplace(numbers, Group{camera, lidar, sample.image.width, sample.image.height, {}})
        .first->second.samples.push_back(sample);
  }
  return groups;
}

Result<Recording> read_recording(const fs::path& root, const std::string& camera_name, const std::string& scene) {
  const fs::path folder = find_tables(root);
  std::error_code error;
  const fs::path data = fs::is_directory(root / "samples", error) ? root : fs::absolute(folder, error).parent_path();
  const Tables tables(folder);
  const auto sensors = read_sensors(tables, camera_name);
  const auto samples = read_files(tables, read_samples(tables, scene), sensors);
  const auto poses = read_poses(tables, samples);
  RecordedFrames frames;
  auto groups = group_samples(samples, sensors, frames.lacks);
  if (groups.empty())
    return fail(ErrorCode::frame_mismatch,
                "no sample of " + folder.string() + " has an image of " + escape_control(camera_name) + " and a cloud");
  auto most = groups.begin();
  for (auto group = groups.begin(); group != groups.end(); ++group)
    if (group->second.samples.size() > most->second.samples.size()) most = group;
  const auto name_of = [](const Sample& sample) { return fs::path(sample.image.file).stem().string(); };
  for (auto group = groups.begin(); group != groups.end(); ++group)
    for (const Sample& sample : group->second.samples)
      if (group != most) frames.lacks.push_back("another calibration for " + name_of(sample));

  Group& group = most->second;
  std::ranges::sort(group.samples, {}, [](const Sample& sample) { return sample.image.timestamp_us; });
  std::size_t without_pose = 0;
  for (const Sample& sample : group.samples) {
    RecordedFrame frame{name_of(sample), data / sample.image.file, std::nullopt, data / sample.cloud.file};
    const bool has_image = fs::exists(frame.image, error), has_cloud = fs::exists(frame.cloud, error);
    if (!has_image || !has_cloud) {  // of parts of the data set, as it is downloaded
      frames.lacks.push_back((has_image ? "no cloud for " : "no image for ") + frame.name);
      continue;
    }
    const auto at_image = poses.find(sample.image.ego_pose), at_scan = poses.find(sample.cloud.ego_pose);
    if (at_image != poses.end() && at_scan != poses.end()) {
      const RigidTransform& T_ego_lidar = group.lidar.T_ego_sensor;
      frame.T_image_time_scan_time = T_ego_lidar.inverse() * at_image->second.inverse() * at_scan->second * T_ego_lidar;
    } else {
      ++without_pose;
    }
    frames.complete.push_back(std::move(frame));
  }
  if (frames.complete.empty())
    return fail(ErrorCode::frame_mismatch, "of " + std::to_string(group.samples.size()) +
                                               " samples none has its files below " + data.string() + ": " +
                                               frames.lacks.back());
  auto camera = Camera::make(CameraModel::rectified, group.width, group.height,
                             {group.camera.intrinsics.begin(), group.camera.intrinsics.end()});
  if (!camera) return propagate(camera);
  Recording recording(*std::move(camera), group.camera.T_ego_sensor.inverse() * group.lidar.T_ego_sensor, std::nullopt,
                      std::move(frames));
  recording.set_cloud_layout({CloudLayout::Scalar::float32, 5});
  if (without_pose > 0)
    recording.set_remarks({std::to_string(without_pose) +
                           " frames have no pose of the vehicle (ego_pose.json): their points "
                           "are not moved to the time of the image"});
  return recording;
}

}  // namespace

Result<Recording> open_nuscenes(const fs::path& root, const std::string& camera, const std::string& scene) {
  try {
    return read_recording(root, camera, scene);
  } catch (const Malformed& what) {
    return fail(what.code, what.why);
  }
}

}  // namespace calib
