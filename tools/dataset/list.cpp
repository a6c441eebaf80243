#include <yaml-cpp/yaml.h>

#include <Eigen/LU>
#include <algorithm>
#include <functional>
#include <initializer_list>
#include <set>

#include "calib/file.hpp"
#include "dataset/calibration_file.hpp"
#include "dataset/frames_by_name.hpp"
#include "dataset/recording.hpp"

namespace calib {
namespace {

namespace fs = std::filesystem;

/// What is wrong, with the line where it is; becomes an `Error` at the door of this file.
struct Malformed {
  YAML::Mark mark;
  std::string why;
};

void check_keys(const YAML::Node& map, const std::string& what, std::initializer_list<const char*> known) {
  if (!map.IsMap()) throw Malformed{map.Mark(), what + " is not a map of keys"};
  std::string names;
  for (const char* name : known) names += (names.empty() ? "" : ", ") + std::string(name);
  std::set<std::string> seen;
  for (const auto& entry : map) {
    const auto key = entry.first.as<std::string>();
    if (std::ranges::find(known, key) == known.end())
      throw Malformed{entry.first.Mark(), what + " has no key '" + escape_control(key) + "'; there are " + names};
    if (!seen.insert(key).second) throw Malformed{entry.first.Mark(), what + " has the key '" + key + "' twice"};
  }
}

template <typename T>
T value(const YAML::Node& parent, const char* key, const char* what) {
  const YAML::Node node = parent[key];
  if (!node) throw Malformed{parent.Mark(), std::string(key) + " is missing"};
  try {
    return node.as<T>();
  } catch (const YAML::Exception&) {
    throw Malformed{node.Mark(), std::string(key) + " is not " + what};
  }
}

Result<Camera> read_camera(const YAML::Node& node) {
  check_keys(node, "camera", {"model", "size", "intrinsics", "distortion", "bits"});
  const auto model = parse_camera_model(value<std::string>(node, "model", "the name of a camera model"));
  if (!model) return propagate(model);
  const auto size = value<std::vector<int>>(node, "size", "[width, height]");
  if (size.size() != 2) throw Malformed{node["size"].Mark(), "size is not [width, height]"};
  std::vector<double> distortion;
  if (node["distortion"]) distortion = value<std::vector<double>>(node, "distortion", "a list of numbers");
  return Camera::make(*model, size[0], size[1], value<std::vector<double>>(node, "intrinsics", "[fx, fy, cx, cy]"),
                      distortion);
}

Result<RigidTransform> read_transform(const YAML::Node& node) {
  check_keys(node, "T_camera_lidar", {"translation_m", "quaternion_xyzw", "matrix"});
  if (!node["matrix"])
    return make_transform(value<std::array<double, 3>>(node, "translation_m", "three numbers"),
                          value<std::array<double, 4>>(node, "quaternion_xyzw", "four numbers"));
  const auto rows = value<std::vector<std::array<double, 4>>>(node, "matrix", "rows of four numbers");
  if (node.size() != 1 || rows.size() < 3 || rows.size() > 4)
    throw Malformed{node.Mark(), "T_camera_lidar is a matrix of 3 or 4 rows, or translation_m and quaternion_xyzw"};
  Eigen::Matrix3d R;
  for (int i = 0; i < 9; ++i) R(i / 3, i % 3) = rows[i / 3][i % 3];
  if (!((R * R.transpose() - Eigen::Matrix3d::Identity()).norm() < 1e-3 && R.determinant() > 0))
    return fail(ErrorCode::bad_transform, "the left three columns of matrix are not a rotation");
  const Eigen::Quaterniond q(R);
  return make_transform({rows[0][3], rows[1][3], rows[2][3]},
                        {q.normalized().x(), q.normalized().y(), q.normalized().z(), q.normalized().w()});
}

/// Nothing where the key is missing.
std::optional<double> read_baseline_m(const YAML::Node& root) {
  if (!root["baseline_m"]) return std::nullopt;
  const auto baseline_m = value<double>(root, "baseline_m", "a number");
  if (!(baseline_m > 0 && baseline_m < 100))
    throw Malformed{root["baseline_m"].Mark(), "baseline_m is not within 0 .. 100 m"};
  return baseline_m;
}

/// 16 where the key is missing.
int read_image_bits(const YAML::Node& camera) {
  if (!camera["bits"]) return 16;
  const int bits = value<int>(camera, "bits", "a number of bits");
  if (bits < 8 || bits > 16) throw Malformed{camera["bits"].Mark(), "bits is not within 8 .. 16"};
  return bits;
}

constexpr std::initializer_list<const char*> keys{"camera", "baseline_m",   "T_camera_lidar", "frames",
                                                  "images", "right_images", "clouds",         "cloud_layout"};

/// The frames that are listed one by one.
std::vector<RecordedFrame> read_frames(const YAML::Node& node, const fs::path& folder) {
  if (!node.IsSequence() || node.size() == 0) throw Malformed{node.Mark(), "frames is not a list of frames"};
  std::vector<RecordedFrame> frames;
  std::set<std::string> names;
  for (const auto& entry : node) {
    check_keys(entry, "a frame", {"image", "right_image", "cloud"});
    const auto path = [&](const char* key) { return folder / value<std::string>(entry, key, "a path"); };
    const fs::path image = path("image");
    const std::string name = image.stem().string();
    // Files of depth are found by this name.
    if (!names.insert(name).second)
      throw Malformed{entry.Mark(), "two frames have images named " + escape_control(name)};
    frames.push_back({name, image, std::nullopt, path("cloud")});
    if (entry["right_image"]) frames.back().right_image = path("right_image");
    if (frames.back().right_image.has_value() != frames.front().right_image.has_value())
      throw Malformed{entry.Mark(), "some frames have a right_image and some have none"};
  }
  return frames;
}

Result<Recording> read_frames_and_calibration(const YAML::Node& root, const fs::path& folder) {
  if (root.IsNull()) throw Malformed{root.Mark(), "the file is empty"};
  check_keys(root, "a recording", keys);
  for (const char* key : {"camera", "T_camera_lidar"})
    if (!root[key]) throw Malformed{root.Mark(), std::string(key) + " is missing"};
  if (!root["frames"] && !root["images"]) throw Malformed{root.Mark(), "frames (or images and clouds) are missing"};
  auto camera = read_camera(root["camera"]);
  if (!camera) return propagate(camera);
  const auto T_camera_lidar = read_transform(root["T_camera_lidar"]);
  if (!T_camera_lidar) return propagate(T_camera_lidar);
  const std::optional<double> baseline_m = read_baseline_m(root);
  if (root["frames"]) {
    if (root["images"] || root["right_images"] || root["clouds"])
      throw Malformed{root.Mark(), "there are both frames and folders of images and clouds"};
    return Recording(*std::move(camera), *T_camera_lidar, baseline_m, {read_frames(root["frames"], folder), {}});
  }
  const auto path = [&](const char* key) { return folder / value<std::string>(root, key, "a folder"); };
  const fs::path images = path("images"), clouds = path("clouds");
  auto frames =
      frames_by_name(images, root["right_images"] ? std::optional(path("right_images")) : std::nullopt, clouds);
  if (!frames) return propagate(frames);
  return Recording(*std::move(camera), *T_camera_lidar, baseline_m, *std::move(frames));
}

Result<Recording> read_list(const YAML::Node& root, const fs::path& folder) {
  auto recording = read_frames_and_calibration(root, folder);
  if (recording) recording->set_image_bits(read_image_bits(root["camera"]));
  if (!recording || !root["cloud_layout"]) return recording;
  const auto layout = parse_cloud_layout(value<std::string>(root, "cloud_layout", "a layout such as float32x4"));
  if (!layout) throw Malformed{root["cloud_layout"].Mark(), layout.error().context};
  recording->set_cloud_layout(*layout);
  return recording;
}

Result<CalibrationFile> read_sensors(const YAML::Node& root) {
  check_keys(root, "a calibration", keys);
  CalibrationFile file;
  if (root["camera"]) {
    auto camera = read_camera(root["camera"]);
    if (!camera) return propagate(camera);
    file.camera = *std::move(camera);
    file.image_bits = read_image_bits(root["camera"]);
  }
  if (root["T_camera_lidar"]) {
    const auto T_camera_lidar = read_transform(root["T_camera_lidar"]);
    if (!T_camera_lidar) return propagate(T_camera_lidar);
    file.T_camera_lidar = *T_camera_lidar;
  }
  file.baseline_m = read_baseline_m(root);
  return file;
}

/// What `read` makes of a file; its errors name the file and the line.
template <typename Value>
Result<Value> read_yaml(const fs::path& yaml, const std::string& text,
                        const std::function<Result<Value>(const YAML::Node&)>& read) {
  const auto malformed = [&yaml](const YAML::Mark& mark, const std::string& why) {
    return fail(ErrorCode::calibration_malformed,
                yaml.string() + (mark.is_null() ? "" : ":" + std::to_string(mark.line + 1)) + ": " + why);
  };
  try {
    auto value = read(YAML::Load(text));
    if (!value && (value.error().code == ErrorCode::bad_camera || value.error().code == ErrorCode::bad_transform))
      value.error().context = yaml.string() + ": " + value.error().context;
    return value;
  } catch (const Malformed& what) {
    return malformed(what.mark, what.why);
  } catch (const YAML::Exception& what) {
    return malformed(what.mark, escape_control(what.msg));
  }
}

constexpr std::uint64_t most_bytes = 2 << 20;  // some ten thousand frames; yaml-cpp takes 300 times that

}  // namespace

Result<Recording> open_list(const fs::path& yaml) {
  if (std::error_code error; fs::is_directory(yaml, error)) {
    const fs::path usual = yaml / "recording.yaml";
    return fail(ErrorCode::recording_not_found,
                yaml.string() + " is a folder, and a list is a YAML file: " +
                    (fs::exists(usual, error) ? "give " + usual.string() : "tools/dataset/README.md describes it"));
  }
  const auto text = read_regular_file(yaml, most_bytes);
  if (!text) return fail(ErrorCode::recording_not_found, text.error().context);
  return read_yaml<Recording>(yaml, *text, [&](const YAML::Node& root) { return read_list(root, yaml.parent_path()); });
}

Result<CalibrationFile> read_calibration_file(const fs::path& yaml) {
  const auto text = read_regular_file(yaml, most_bytes);
  if (!text) return fail(ErrorCode::calibration_missing, text.error().context);
  return read_yaml<CalibrationFile>(yaml, *text, read_sensors);
}

}  // namespace calib
