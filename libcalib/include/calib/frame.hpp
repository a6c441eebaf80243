#pragma once

#include <chrono>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "calib/camera.hpp"
#include "calib/result.hpp"

namespace calib {

/// When a sensor measured, by the sensor's (ROS message's) clock: nanoseconds since the epoch of that clock.
using Timestamp = std::chrono::nanoseconds;

/// What a message says about its samples. Nothing is computed from it.
struct MessageNotes {
  /// As sent, cut to `longest_frame_id` bytes; untrusted text. Empty where there is no message or it names no frame.
  std::string frame_id = {};
  /// What was wrong in a field that the samples do not depend on, and was ignored.
  std::vector<Error> remarks = {};

  static constexpr std::size_t longest_frame_id = 128;
};

/// An 8-bit grey image. Row-major, no padding: `pixels.size() == width * height`.
struct Image {
  Timestamp stamp{};
  int width = 0;
  int height = 0;
  std::vector<std::uint8_t> pixels;
  /// The same in colour, red, green and blue interleaved: three bytes a pixel. Empty when the source is grey or colour
  /// was not asked for.
  std::vector<std::uint8_t> rgb = {};
  MessageNotes notes = {};
};

/// Depth that came from outside, in the frame and pixels of the camera that made it: inverse depth (1/m) along the
/// optical axis, row-major, 0 where there is none.
struct DepthImage {
  Timestamp stamp{};
  int width = 0;
  int height = 0;
  std::vector<float> inverse_depth;
  MessageNotes notes = {};
};

/// One LiDAR return in the LiDAR frame.
struct LidarPoint {
  float x_m, y_m, z_m;
  /// Reflectance in the sensor's own unit, 0 where the sensor gives none.
  float reflectance;
};

/// One revolution of a LiDAR: only finite points within 500 m.
struct LidarScan {
  Timestamp stamp{};
  std::vector<LidarPoint> points;
  MessageNotes notes = {};
};

/// How fast the vehicle turned at one moment: the length of its angular velocity, which is the same however the sensor
/// that measured it is mounted.
struct TurnRate {
  Timestamp stamp{};
  double rate_rad_s = 0;
};

/// An image, the scan taken at nearly the same time, and what was taken with the image: the right one of a stereo
/// camera, or depth.
struct FramePair {
  Image image;
  std::optional<Image> right_image;
  LidarScan scan;
  std::optional<DepthImage> depth = {};
  /// The fastest turn between the two stamps, where a turn rate is measured.
  std::optional<double> turn_rate_rad_s = {};
  /// Scan stamp minus image stamp.
  [[nodiscard]] std::chrono::nanoseconds time_difference() const { return scan.stamp - image.stamp; }
};

}  // namespace calib
