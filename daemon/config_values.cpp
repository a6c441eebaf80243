#include "config_values.hpp"

#include <algorithm>

#include "dds/names.hpp"

namespace calib {

bool is_name(std::string_view name, std::string_view others) {
  return !name.empty() && name.size() <= 64 && std::ranges::all_of(name, [&](char c) {
    return (c >= 'a' && c <= 'z') || (c >= '0' && c <= '9') || others.find(c) != std::string_view::npos;
  });
}

std::string read_topic(const ConfigNode& node) {
  const std::string name = node.text();
  if (const auto dds_name = dds_topic_name(name); !dds_name) node.refuse(dds_name.error().context);
  return name;
}

std::filesystem::path read_absolute_path(const ConfigNode& node) {
  const std::filesystem::path path = node.text();
  if (!path.is_absolute()) node.refuse("needs an absolute path");
  return path;
}

Camera read_camera_model(const ConfigNode& node) {
  const ConfigNode model_key = node.at("model"), size_key = node.at("size"), intrinsics_key = node.at("intrinsics");
  // `Camera::make` is asked with one more key at a time, so that a refusal names the key that is wrong.
  const auto model = parse_camera_model(model_key.text());
  if (!model) model_key.refuse(model.error().context);
  const auto size = size_key.items();
  if (size.size() != 2) size_key.refuse("needs width and height in pixels");
  const int width = size[0].integer(16, 65535), height = size[1].integer(16, 65535);
  const auto sized = Camera::make(CameraModel::rectified, width, height, {100, 100, 0, 0});
  if (!sized) size_key.refuse(sized.error().context);
  const auto intrinsics = intrinsics_key.numbers(4, -1e6, 1e6);
  const auto pinhole = Camera::make(CameraModel::rectified, width, height, intrinsics);
  if (!pinhole) intrinsics_key.refuse(pinhole.error().context);
  const auto distortion_key = node.find("distortion");
  std::vector<double> distortion;
  if (distortion_key) distortion = distortion_key->numbers(distortion_key->items().size(), -1e6, 1e6);
  auto camera = Camera::make(*model, width, height, intrinsics, distortion);
  if (!camera) distortion_key.value_or(model_key).refuse(camera.error().context);
  return *camera;
}

}  // namespace calib
