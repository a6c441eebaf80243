#pragma once

#include <array>
#include <vector>

#include "calib/camera.hpp"
#include "calib/frame.hpp"
#include "calib/result.hpp"
#include "ros2.h"

namespace calib {

/// From ROS 2 messages, as anybody may have sent them, to the values of libcalib. Nothing a message says is
/// believed before it is checked, in 64-bit arithmetic, against the bytes that came with it. A message outside
/// its bounds gives `malformed:<what>`:
///
// clang-format off
/// | code                            | message                | bound                                                |
/// |---------------------------------|------------------------|------------------------------------------------------|
/// | malformed:stamp                 | all                    | sec >= 0, nanosec < 1e9                              |
/// | malformed:encoding              | Image                  | on the list of `decode_image`                        |
/// | malformed:depth_encoding        | Image, CompressedImage | not 16UC1 or 32FC1: that is depth                    |
/// | malformed:image_size            | Image, CameraInfo      | 1 <= width * height <= 64 Mpx                        |
/// | malformed:step                  | Image                  | step >= width * bytes per pixel                      |
/// | malformed:image_data            | Image                  | data >= step * height; OpenCV takes it               |
/// | malformed:compressed_size       | CompressedImage        | 1 .. 32'000'000 bytes                                |
/// | malformed:compressed_format     | CompressedImage        | begins as a JPEG or a PNG does                       |
/// | malformed:compressed_dimensions | CompressedImage        | 1 .. 64 Mpx, by its header                           |
/// | malformed:compressed_data       | CompressedImage        | whole; decodes to its header's size                  |
/// | malformed:point_step            | PointCloud2            | 1 <= point_step <= 4096                              |
/// | malformed:cloud_size            | PointCloud2            | width * height <= 4'000'000                          |
/// | malformed:fields                | PointCloud2            | at most 64 fields                                    |
/// | malformed:field_type            | PointCloud2            | datatype 1 .. 8                                      |
/// | malformed:field_bounds          | PointCloud2            | offset + size * count <= point_step                  |
/// | malformed:xyz                   | PointCloud2            | x, y, z once each, FLOAT32 or FLOAT64                |
/// | malformed:row_step              | PointCloud2            | row_step >= width * point_step                       |
/// | malformed:cloud_data            | PointCloud2            | data >= (height - 1) * row_step + width * point_step |
/// | malformed:intrinsics            | CameraInfo             | K and P finite, 1 < fx, fy < 1e5                     |
/// | malformed:distortion            | CameraInfo             | a known model, D finite and as long as it asks       |
/// | malformed:roi                   | CameraInfo             | roi inside width x height, binning inside the roi    |
// clang-format on

/// Grey by OpenCV's weights, 8 bit. Encodings: rgb8 bgr8 rgba8 bgra8 mono8 8UC1, 8UC3 (as bgr8), mono16 (its
/// full range becomes 0 .. 255), bayer_{rggb,bggr,gbrg,grbg}8, yuv422 = uyvy, yuv422_yuy2 = yuyv.
[[nodiscard]] Result<Image> decode_image(const sensor_msgs_msg_dds__Image_& message);

/// JPEG or PNG by their first bytes, whatever `format` says. An EXIF orientation is not applied: calibration
/// is about the sensor's own pixels.
[[nodiscard]] Result<Image> decode_compressed_image(const sensor_msgs_msg_dds__CompressedImage_& message);

/// Reflectance is the field `intensity`, else `reflectance`, else 0. Dropped: points that are not finite,
/// beyond 500 m, or exactly at the origin, which is how some drivers write "no return". An empty cloud is an
/// empty scan.
[[nodiscard]] Result<LidarScan> decode_cloud(const sensor_msgs_msg_dds__PointCloud2_& message);

/// What a camera says about itself, for the image as it is published: sensor_msgs/CameraInfo's K and P are for the full
/// sensor; here its roi is cut out of that and its binning merged (a binned pixel's centre is that of its block).
struct CameraInfo {
  Timestamp stamp{};
  int width = 0;
  int height = 0;
  /// Of the raw image, with D in its order: `plumb_bob`, `rational_polynomial`, `equidistant` (also called fisheye);
  /// `rectified`, with no D, where the message names no model or "none".
  CameraModel model = CameraModel::rectified;
  /// Row-major, pixels.
  std::array<double, 9> K{};
  std::vector<double> D;
  std::array<double, 12> P{};
};
[[nodiscard]] Result<CameraInfo> decode_camera_info(const sensor_msgs_msg_dds__CameraInfo_& message);

/// Shared by the decoders. Fails with `malformed:stamp`.
[[nodiscard]] Result<Timestamp> decode_stamp(const std_msgs_msg_dds__Header_& header);

inline constexpr std::int64_t max_image_pixels = 64'000'000;

}  // namespace calib
