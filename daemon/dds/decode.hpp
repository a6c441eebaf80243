#pragma once

#include <array>
#include <string>
#include <vector>

#include "calib/camera.hpp"
#include "calib/frame.hpp"
#include "calib/result.hpp"
#include "dds/image_bound.hpp"
#include "dds/names.hpp"
#include "ros2.h"

namespace calib {

// From ROS 2 messages to the values of libcalib. Any program may have sent them: each number in a message is checked,
// in 64-bit arithmetic, against the bytes of the message before it is used. A message outside its bounds gives
// `malformed:<what>`, with the value and the bound. What samples do not depend on is ignored when it is wrong, and
// becomes a remark with the same code (`MessageNotes`): those are marked *. calibd-messages(5) explains all of them.
//
// clang-format off
// | code                            | message                | bound                                                |
// |---------------------------------|------------------------|------------------------------------------------------|
// | malformed:stamp                 | all                    | sec >= 0, nanosec < 1e9                              |
// | malformed:encoding              | Image, DisparityImage  | one of those listed at the decoder; * YUV 4:2:2 with |
// |                                 |                        | brightness where the encoding has colour             |
// | malformed:depth_encoding        | Image, CompressedImage | not 16UC1 or 32FC1, which hold depth                 |
// | malformed:image_size            | all with an image      | 1 <= width * height <= 64 Mpx                        |
// | malformed:step                  | Image, DisparityImage  | a row of pixels <= step <= the row + 4096 bytes;     |
// |                                 |                        | * where the data is as long as rows without padding, |
// |                                 |                        | or as a buffer whose width and height are rounded up |
// | malformed:image_data            | Image, DisparityImage  | step * height <= data <= that + 64 KiB; OpenCV takes |
// | image_size_mismatch             | all with an image      | the size from the configuration (ImageBound)         |
// | malformed:disparity_scale       | DisparityImage         | f and t finite and > 0                               |
// | malformed:disparity_range *     | DisparityImage         | min_disparity <= max_disparity, both finite          |
// | malformed:disparity_sign *      | DisparityImage         | more positive than negative disparities              |
// | malformed:valid_window *        | DisparityImage         | inside the image                                     |
// | image_bits *                    | Image, CompressedImage | 16-bit values above the 14, 12 or 10 lowest bits     |
// | malformed:compressed_size       | CompressedImage        | 1 .. width * height * 4 + 64 KiB, at most 32'000'000 |
// | malformed:compressed_format     | CompressedImage        | JPEG (one frame, Huffman) or PNG (not animated)      |
// | malformed:compressed_dimensions | CompressedImage        | 1 .. 64 Mpx in its header                            |
// | malformed:compressed_scans      | CompressedImage        | at most 32 scans of a JPEG                           |
// | malformed:compressed_metadata   | CompressedImage        | PNG: at most 1 MiB, 4 compressed texts or profiles   |
// | malformed:compressed_data       | CompressedImage        | complete; decodes to the size in its header          |
// | malformed:point_step            | PointCloud2            | 1 <= point_step <= 4096                              |
// | malformed:cloud_size            | PointCloud2            | width * height <= lidar.max_points                   |
// | malformed:fields                | PointCloud2            | at most 64 fields                                    |
// | malformed:field_type            | PointCloud2            | datatype 1 .. 8; * of other fields than x, y, z      |
// | malformed:field_bounds          | PointCloud2            | offset + size * count <= point_step; * likewise      |
// | malformed:xyz                   | PointCloud2            | x, y, z once each, FLOAT32 or FLOAT64                |
// | malformed:row_step              | PointCloud2            | a row of points <= row_step <= the row + 4096 bytes, |
// |                                 |                        | where there are two rows or more; * as step          |
// | malformed:cloud_layout          | PointCloud2            | coordinates that a LiDAR can measure, in 4 of 5      |
// |                                 |                        | points: 0, or 1e-17 .. 1e7 (`MeasurableCount`)       |
// | malformed:cloud_data            | PointCloud2            | all rows, and at most 64 KiB more                    |
// | malformed:uncalibrated          | CameraInfo             | K and P are not both zero                            |
// | malformed:intrinsics            | CameraInfo             | K and P finite, 1 < fx, fy < 1e5 in K, or in P where |
// |                                 |                        | K is zero                                            |
// | malformed:distortion            | CameraInfo             | a known model; D finite, as long as the model needs; |
// |                                 |                        | zeros behind that are ignored                        |
// | malformed:roi                   | CameraInfo             | roi inside width x height, binning inside the roi    |
// | malformed:angular_velocity      | Imu, Odometry          | measured, finite, below 100 rad/s                    |
// | malformed:refused               | all                    | no library throws an exception                       |
// | out_of_memory                   | all                    | enough memory                                        |
// clang-format on
//
// All of this is checked before anything is decoded, converted or allocated, but for the values of pixels and points. A
// decoded image occupies 4 bytes per pixel, 3 more while one of 16 bits is converted (6 of a PNG), and 8 more while a
// progressive JPEG is decoded. The slowest image that is accepted, a progressive JPEG of
// noise in 32 scans, takes 0.1 s at 1242 x 375 and 3 s at 4096 x 3000 (one core of a server), ten times as long as one
// of a camera.

/// Whether an image is decoded in colour as well as in grey.
enum class Colour { none, rgb };

/// To 8-bit grey, by OpenCV's weights. Encodings: rgb8 bgr8 rgba8 bgra8 mono8 8UC1, 8UC3 (as bgr8), 8UC4 (as bgra8),
/// bayer_{rggb,bggr,gbrg,grbg}8, yuv422 = uyvy, yuv422_yuy2 = yuyv, nv12, nv21, i420 = yuv420 and yv12 (whose data has
/// half as many rows again), nv24 (twice as many again); and mono16, rgb16, bgr16, 16UC3, rgba16, bgra16, 16UC4 and
/// bayer_*16, of which 0 .. 2^`significant_bits` - 1 becomes 0 .. 255.
[[nodiscard]] Result<Image> decode_image(const sensor_msgs_msg_dds__Image_& message, Colour colour = Colour::none,
                                         const ImageBound& bound = {});

/// JPEG or PNG, told by the first bytes. The field `format` tells a depth image, and a Bayer mosaic that was compressed
/// as it is ("bayer_rggb8; jpeg compressed "). An EXIF orientation is ignored: a calibration refers to the pixels of
/// the sensor. A PNG of 16 bits is scaled as a raw image where `significant_bits` are fewer, else reduced to its high
/// bytes.
[[nodiscard]] Result<Image> decode_compressed_image(const sensor_msgs_msg_dds__CompressedImage_& message,
                                                    Colour colour = Colour::none, const ImageBound& bound = {});

/// Depth along the optical axis (REP 118): 16UC1 (or mono16) in millimetres, where 0 is no depth, or 32FC1 in metres,
/// where anything but a positive finite number is no depth.
[[nodiscard]] Result<DepthImage> decode_depth(const sensor_msgs_msg_dds__Image_& message, const ImageBound& bound = {});

/// Disparities (32FC1, pixels) of the left image; depth is f t / disparity. A pixel has no depth where the disparity is
/// not positive or outside min_disparity .. max_disparity, or the pixel is outside the valid window. A publisher may
/// leave that range and that window at 0, which means no limit, as do those that make no sense.
[[nodiscard]] Result<DepthImage> decode_disparity(const stereo_msgs_msg_dds__DisparityImage_& message,
                                                  const ImageBound& bound = {});

/// Counts over all points of a cloud, including dropped ones. They reveal a cloud that is not in metres.
struct CloudStatistics {
  std::uint64_t points = 0, not_finite = 0, at_origin = 0, too_far = 0;
  /// Over an even sample of the points that are finite and not at the origin, also beyond 500 m. 0 without such points.
  double median_range_m = 0;
};
struct DecodedCloud : LidarScan {
  CloudStatistics statistics = {};
  /// Whether one of `reflectance_names` is among its fields.
  bool has_reflectance = true;
};
/// The greatest value of `lidar.max_points`.
inline constexpr std::uint64_t max_cloud_points = 4'000'000;

/// Drops points that are not finite, beyond 500 m, or exactly at the origin (some drivers mark "no return" so).
/// Reflectance is the first of `reflectance_names` that is among the fields, or else 0. A cloud without points gives a
/// scan without points.
[[nodiscard]] Result<DecodedCloud> decode_cloud(const sensor_msgs_msg_dds__PointCloud2_& message,
                                                std::uint64_t max_points = max_cloud_points);

/// sensor_msgs/CameraInfo, converted to the image as it is published. In the message, K and P are for the full sensor;
/// here they are for the roi after binning (the centre of a binned pixel is that of its block).
struct CameraInfo {
  Timestamp stamp{};
  int width = 0;
  int height = 0;
  /// Of the raw image, with D in the order of the model: `plumb_bob`, `rational_polynomial` or `equidistant` (also
  /// called fisheye). `rectified`, without D, where the message names no model or "none".
  CameraModel model = CameraModel::rectified;
  /// Row-major, pixels.
  std::array<double, 9> K{};
  std::vector<double> D;
  std::array<double, 12> P{};
  /// Rotation from the frame of the raw camera to the rectified one, row-major, as sent: all zero if not calibrated.
  std::array<double, 9> R{};
  /// What width and height follow from, where binning or a roi changed them: "840 x 280 with binning 2 x 2".
  std::string reduced_from = {};
  MessageNotes notes = {};
};
/// K is zero where only P is given, and P is zero where the driver leaves it out.
[[nodiscard]] Result<CameraInfo> decode_camera_info(const sensor_msgs_msg_dds__CameraInfo_& message,
                                                    InfoReduction reduction = InfoReduction::as_specified);

/// The norm of the angular velocity. An Imu that does not measure it has -1 as the first element of its covariance.
[[nodiscard]] Result<TurnRate> decode_imu(const sensor_msgs_msg_dds__Imu_& message);
[[nodiscard]] Result<TurnRate> decode_odometry(const nav_msgs_msg_dds__Odometry_& message);

// Used by several decoders.

/// Fails with `malformed:stamp`.
[[nodiscard]] Result<Timestamp> decode_stamp(const std_msgs_msg_dds__Header_& header);
/// Fails with `malformed:image_size`, `malformed:step`, `malformed:image_data` or `image_size_mismatch`.
/// Returns the bytes from one row to the next. `extra_rows` follow those of the image's height.
[[nodiscard]] Result<std::uint64_t> check_layout(const sensor_msgs_msg_dds__Image_& message,
                                                 std::uint64_t bytes_per_pixel, const ImageBound& bound,
                                                 MessageNotes& notes, std::uint64_t extra_rows = 0);

/// With the frame of the header, escaped, and without remarks.
[[nodiscard]] MessageNotes notes_of(const std_msgs_msg_dds__Header_& header);
/// Of a message at most eight are kept.
void add_remark(MessageNotes& notes, ErrorCode code, std::string what);

/// Greatest padding of a row, and greatest excess of the data over what the header asks for.
inline constexpr std::uint64_t max_row_padding = 4096, max_data_slack = 64 * 1024;

}  // namespace calib
