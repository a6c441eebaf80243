#pragma once

#include <filesystem>
#include <string>

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

}  // namespace calib
