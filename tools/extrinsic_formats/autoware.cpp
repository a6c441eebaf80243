#include "extrinsic_formats/format_files.hpp"

namespace calib::formats {
namespace {

constexpr std::string_view link_suffix = "camera_link";
constexpr std::string_view optical_suffix = "camera_optical_link";

Eigen::Vector3d three(const ConfigNode& node, const std::array<const char*, 3>& keys, double bound) {
  return {node.at(keys[0]).number(-bound, bound), node.at(keys[1]).number(-bound, bound),
          node.at(keys[2]).number(-bound, bound)};
}

void add_parent(const std::string& parent, const ConfigNode& children, const std::string& file, Frames& frames) {
  for (const auto& [child, pose] : children.entries()) {
    pose.with_keys({"x", "y", "z", "roll", "pitch", "yaw"});
    frames.edges.push_back(
        {parent, child,
         from_xyz_rpy(three(pose, {"x", "y", "z"}, max_step_m), three(pose, {"roll", "pitch", "yaw"}, 10)), file});
    // The description of a camera adds its optical frame.
    if (child.ends_with(link_suffix))
      frames.edges.push_back({child, child.substr(0, child.size() - link_suffix.size()) + std::string(optical_suffix),
                              T_optical_body().inverse(), file});
  }
}

}  // namespace

Result<Frames> read_autoware(const std::vector<TextFile>& files) {
  Frames frames;
  for (const TextFile& file : files) {
    const auto read = parse_yaml(file, [&](const ConfigNode& node) {
      for (const auto& [parent, children] : node.entries()) add_parent(parent, children, file.name, frames);
    });
    if (!read) return propagate(read);
  }
  return frames;
}

std::string autoware_text(const FrameEdge& pose) {
  const auto t = translation_m(pose.T_parent_child);
  const Eigen::Vector3d rpy = roll_pitch_yaw_rad(pose.T_parent_child.linear());
  const auto field = [](const char* name, double value) {
    return "    " + std::string(name) + ": " + number_text(value) + "\n";
  };
  return pose.parent + ":\n  " + pose.child + ":\n" + field("x", t[0]) + field("y", t[1]) + field("z", t[2]) +
         field("roll", rpy.x()) + field("pitch", rpy.y()) + field("yaw", rpy.z());
}

}  // namespace calib::formats
