#pragma once

#include <array>
#include <vector>

#include "calib/camera.hpp"
#include "calib/frame.hpp"
#include "calib/result.hpp"
#include "dds/image_bound.hpp"
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
/// | malformed:encoding              | Image, DisparityImage  | on the list of the decoder                           |
/// | malformed:depth_encoding        | Image, CompressedImage | not 16UC1 or 32FC1: that is depth                    |
/// | malformed:image_size            | all with an image      | 1 <= width * height <= 64 Mpx                        |
/// | malformed:step                  | Image, DisparityImage  | a row of pixels <= step <= the row + 4096 bytes      |
/// | malformed:image_data            | Image, DisparityImage  | step * height <= data <= that + 64 KiB; OpenCV takes |
/// | image_size_mismatch             | all with an image      | the size that the configuration tells (ImageBound)   |
/// | malformed:disparity_scale       | DisparityImage         | f and t finite and > 0                               |
/// | malformed:disparity_range       | DisparityImage         | min_disparity <= max_disparity, both finite          |
/// | malformed:valid_window          | DisparityImage         | inside the image                                     |
/// | malformed:compressed_size       | CompressedImage        | 1 .. width * height * 4 + 64 KiB, at most 32'000'000 |
/// | malformed:compressed_format     | CompressedImage        | JPEG (one frame, Huffman's code) or PNG (no movie)   |
/// | malformed:compressed_dimensions | CompressedImage        | 1 .. 64 Mpx, by its header                           |
/// | malformed:compressed_scans      | CompressedImage        | at most 32 scans of a JPEG                           |
/// | malformed:compressed_metadata   | CompressedImage        | at most 1 MiB in a PNG; 4 compressed texts, profiles |
/// | malformed:compressed_data       | CompressedImage        | whole; decodes to its header's size                  |
/// | malformed:point_step            | PointCloud2            | 1 <= point_step <= 4096                              |
/// | malformed:cloud_size            | PointCloud2            | width * height <= lidar.max_points                   |
/// | malformed:fields                | PointCloud2            | at most 64 fields                                    |
/// | malformed:field_type            | PointCloud2            | datatype 1 .. 8                                      |
/// | malformed:field_bounds          | PointCloud2            | offset + size * count <= point_step                  |
/// | malformed:xyz                   | PointCloud2            | x, y, z once each, FLOAT32 or FLOAT64                |
/// | malformed:row_step              | PointCloud2            | a row of points <= row_step <= the row + 4096 bytes  |
/// | malformed:cloud_data            | PointCloud2            | data as long as its rows, and at most 64 KiB more    |
/// | malformed:intrinsics            | CameraInfo             | K and P finite, 1 < fx, fy < 1e5                     |
/// | malformed:distortion            | CameraInfo             | a known model, D finite and as long as it asks       |
/// | malformed:roi                   | CameraInfo             | roi inside width x height, binning inside the roi    |
/// | malformed:angular_velocity      | Imu, Odometry          | finite, below 100 rad/s, and there at all            |
/// | malformed:refused               | all                    | no library throws over it                            |
/// | out_of_memory                   | all                    | there is memory for it                               |
// clang-format on
///
/// All of this is checked before anything is decoded, converted or allocated. What is taken holds 4 bytes per pixel, 8
/// more while a progressive JPEG is decoded. The worst that is taken, a progressive JPEG of noise in 32 scans, takes
/// 0.1 s at 1242 x 375 and 3 s at 4096 x 3000 (one core of a server); a camera's take a tenth of that.

/// Whether an image's colour is wanted beside its grey.
enum class Colour { none, rgb };

/// Grey by OpenCV's weights, 8 bit. Encodings: rgb8 bgr8 rgba8 bgra8 mono8 8UC1, 8UC3 (as bgr8), mono16 (its
/// full range becomes 0 .. 255), bayer_{rggb,bggr,gbrg,grbg}8, yuv422 = uyvy, yuv422_yuy2 = yuyv.
[[nodiscard]] Result<Image> decode_image(const sensor_msgs_msg_dds__Image_& message, Colour colour = Colour::none,
                                         const ImageBound& bound = {});

/// JPEG or PNG by their first bytes, whatever `format` says. An EXIF orientation is not applied: calibration
/// is about the sensor's own pixels.
[[nodiscard]] Result<Image> decode_compressed_image(const sensor_msgs_msg_dds__CompressedImage_& message,
                                                    Colour colour = Colour::none, const ImageBound& bound = {});

/// Depth along the optical axis, as REP 118 has it: 16UC1 in millimetres, where 0 is none, or 32FC1 in metres, where
/// what is not a positive finite number is none.
[[nodiscard]] Result<DepthImage> decode_depth(const sensor_msgs_msg_dds__Image_& message, const ImageBound& bound = {});

/// Disparities (32FC1, pixels) of the left image: depth is f t / disparity. None where that is not positive, outside
/// min_disparity .. max_disparity (which a producer may leave at 0), or outside the valid window (likewise).
[[nodiscard]] Result<DepthImage> decode_disparity(const stereo_msgs_msg_dds__DisparityImage_& message,
                                                  const ImageBound& bound = {});

/// What a cloud held, taken or dropped: one in another unit than metres shows here.
struct CloudCensus {
  std::uint64_t points = 0, not_finite = 0, at_origin = 0, too_far = 0;
  /// Of an even sample of what is neither: before anything is dropped for being far. 0 when there is none.
  double median_range_m = 0;
};
struct DecodedCloud : LidarScan {
  CloudCensus census = {};
};
/// What `lidar.max_points` may be at most.
inline constexpr std::uint64_t max_cloud_points = 4'000'000;

/// Reflectance is the field `intensity`, else `reflectance`, else 0. Dropped: points that are not finite,
/// beyond 500 m, or exactly at the origin, which is how some drivers write "no return". An empty cloud is an
/// empty scan.
[[nodiscard]] Result<DecodedCloud> decode_cloud(const sensor_msgs_msg_dds__PointCloud2_& message,
                                                std::uint64_t max_points = max_cloud_points);

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
  /// Turns the raw camera's frame into the rectified one; row-major. As sent: all zero where nobody calibrated.
  std::array<double, 9> R{};
};
[[nodiscard]] Result<CameraInfo> decode_camera_info(const sensor_msgs_msg_dds__CameraInfo_& message);

/// The length of the angular velocity. An Imu that measures none says so by -1 as the first element of its covariance.
[[nodiscard]] Result<TurnRate> decode_imu(const sensor_msgs_msg_dds__Imu_& message);
[[nodiscard]] Result<TurnRate> decode_odometry(const nav_msgs_msg_dds__Odometry_& message);

/// Shared by the decoders. Fails with `malformed:stamp`.
[[nodiscard]] Result<Timestamp> decode_stamp(const std_msgs_msg_dds__Header_& header);
/// Fails with `malformed:image_size`, `malformed:step`, `malformed:image_data` or `image_size_mismatch`.
[[nodiscard]] Result<void> check_layout(const sensor_msgs_msg_dds__Image_& message, std::uint64_t bytes_per_pixel,
                                        const ImageBound& bound);

/// By how much rows may be padded, and data be longer than what its header needs.
inline constexpr std::uint64_t max_row_padding = 4096, max_data_slack = 64 * 1024;

}  // namespace calib
