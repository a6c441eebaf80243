#pragma once

#include <filesystem>
#include <optional>
#include <string>

#include "dataset/bag/bag.hpp"

namespace calib {

/// What is read of a recording of rosbag2. Topics that are empty are chosen where there is one candidate.
struct BagOptions {
  std::string image, cloud, info, right_image, right_info, depth;
  /// With `camera`, `T_camera_lidar` or `baseline_m`, which go before what the recording holds; may be empty.
  std::filesystem::path calibration;
  /// "raw" or "rectified"; empty: by the topic's name.
  std::string image_is;
  double max_time_difference_ms = 50;  // as sampling.max_time_difference of calibd.yaml
  /// What frames must have.
  bool needs_right_image = false, needs_depth = false;
  /// Frames have right images where the image's topic has a counterpart and its camera is known.
  bool takes_right_image = false;
};

struct BagTopics {
  BagTopic image, cloud;
  std::optional<BagTopic> info, right_image, right_info, depth;
};

/// Fails with `bad_topic`, and with the candidates, when there is no topic or more than one for something.
[[nodiscard]] Result<BagTopics> choose_topics(const Bag& bag, const BagOptions& options);

/// Whether images of a topic are rectified, by its name: image_rect, image_rect_color, rectified/image.
[[nodiscard]] bool names_rectified_images(const std::string& topic);

/// CameraInfo of an image's topic, by convention: /camera/camera_info of /camera/image_raw; or the only one there is.
[[nodiscard]] std::optional<BagTopic> info_beside(const Bag& bag, const BagTopic& image);

/// The topics of a recording, in a line: at most 20.
[[nodiscard]] std::string list_of(const std::vector<BagTopic>& topics);

}  // namespace calib
