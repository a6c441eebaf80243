#include <charconv>

#include "calib/config_transform.hpp"
#include "extrinsic_formats/format_files.hpp"

namespace calib::formats {
namespace {

constexpr std::string_view to_camera = "T_cam_";

/// N of camN; nothing for any other name.
std::optional<int> camera_number(std::string_view name) {
  if (!name.starts_with("cam") || name.size() > 6) return std::nullopt;
  int number{};
  const auto [end, error] = std::from_chars(name.data() + 3, name.data() + name.size(), number);
  return error == std::errc() && end == name.data() + name.size() && number >= 0 ? std::optional(number) : std::nullopt;
}

void add_camera(const std::string& camera, int number, const ConfigNode& node, const std::string& file,
                Frames& frames) {
  for (const auto& [key, value] : node.entries()) {
    if (key == "T_cn_cnm1") {
      if (number == 0) value.refuse("cam0 has no camera before it in the chain");
      frames.edges.push_back({camera, "cam" + std::to_string(number - 1), read_matrix(value), file});
    } else if (key.starts_with(to_camera) && key.size() > to_camera.size()) {
      const std::string sensor = key.substr(to_camera.size());
      frames.edges.push_back({camera, sensor, read_matrix(value), file});
      if (sensor == "lidar") frames.lidar = sensor;
    }
  }
}

}  // namespace

Result<Frames> read_kalibr(const std::vector<TextFile>& files) {
  Frames frames;
  int cameras = 0;
  for (const TextFile& file : files) {
    const auto read = parse_yaml(file, [&](const ConfigNode& node) {
      for (const auto& [name, camera] : node.entries())
        if (const auto number = camera_number(name)) {
          ++cameras;
          if (cameras == 1) frames.camera = name;
          add_camera(name, *number, camera, file.name, frames);
        }
      if (cameras == 0) node.refuse("holds no camera cam0, cam1, ...; it is no camchain of Kalibr");
    });
    if (!read) return propagate(read);
  }
  if (cameras != 1) frames.camera.reset();
  frames.remark = "; a sensor NAME is that of a key T_cam_NAME";
  return frames;
}

std::string kalibr_text(const FrameEdge& pose) {
  std::string text = pose.parent + ":\n  " + std::string(to_camera) + pose.child + ":\n";
  for (const auto& row : matrix_rows(pose.T_parent_child, 4)) {
    text += "  - [";
    for (const double value : row) text += (text.ends_with('[') ? "" : ", ") + number_text(value);
    text += "]\n";
  }
  return text;
}

}  // namespace calib::formats
