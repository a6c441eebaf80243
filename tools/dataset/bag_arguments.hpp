#pragma once

#include <CLI/CLI.hpp>
#include <string>
#include <tuple>

#include "dataset/bag/bag_options.hpp"

namespace calib {

/// The options of programs that read a recording of rosbag2: which topics, and what they do not tell.
inline void add_bag_options(CLI::App& to, BagOptions& bag) {
  const char* const group = "rosbag2";
  for (const auto& [name, topic, what] :
       {std::tuple("--image-topic", &bag.image, "Image or CompressedImage; default: the only camera"),
        std::tuple("--cloud-topic", &bag.cloud, "PointCloud2; default: the only one"),
        std::tuple("--info-topic", &bag.info, "CameraInfo; default: camera_info beside the image topic"),
        std::tuple("--right-image-topic", &bag.right_image, "Of stereo depth; default: the image topic's with right"),
        std::tuple("--right-info-topic", &bag.right_info, "Likewise; default: camera_info beside it")})
    to.add_option(name, *topic, what)->group(group)->option_text("NAME");
  to.add_option("--calibration", bag.calibration, "YAML file with camera, T_camera_lidar or baseline_m, as in a list")
      ->group(group)
      ->option_text("FILE");
  to.add_option("--image-is", bag.image_is, "raw (K and D) or rectified (P); default: by the topic's name")
      ->group(group)
      ->check(CLI::IsMember({"raw", "rectified"}));
  to.add_option("--max-time-difference-ms", bag.max_time_difference_ms, "Between the image and the cloud of a frame")
      ->group(group)
      ->check(CLI::Range(0.0, 1000.0))
      ->capture_default_str();
}

inline void add_bag_depth_option(CLI::App& to, BagOptions& bag) {
  to.add_option("--depth-topic", bag.depth, "Image of 16UC1 or 32FC1, or DisparityImage; default: the only one")
      ->group("rosbag2")
      ->option_text("NAME");
}

/// The first of them that was given, or nothing.
[[nodiscard]] inline std::string given_bag_option(const CLI::App& to) {
  for (const CLI::Option* option : to.get_options([](const CLI::Option* o) { return o->get_group() == "rosbag2"; }))
    if (option->count() > 0) return "--" + option->get_lnames().front();
  return {};
}

}  // namespace calib
