#include "message_faults.hpp"

#include <algorithm>
#include <array>

namespace calib {
namespace {

using enum ErrorCode;

constexpr std::string_view truncated = "the message was cut short, or its header is not that of its data";
constexpr std::string_view another_topic =
    "configure another topic of the same sensor, or have the messages republished in a form that calibd reads";
constexpr std::string_view no_camera_info =
    "calibrate the camera, or give its lens in the configuration and leave camera.info out";
constexpr std::string_view other_jpeg =
    "configure the raw image topic instead of the compressed one, or have image_transport republish it";
constexpr std::string_view nothing_to_do = "nothing has to be done: calibd ignores it";

constexpr std::array faults{
    MessageFault{malformed_stamp, "the driver does not write header.stamp as ROS 2 does",
                 "have the driver stamp each message with the time of its measurement"},
    MessageFault{malformed_refused, "a library of calibd's failed over this message",
                 "report it with a recording of the topic; other messages are not affected"},
    MessageFault{malformed_fields, "the message is hostile, or of a program that publishes more than points",
                 another_topic},
    MessageFault{malformed_field_type, "the driver describes a field with a type that PointField does not have",
                 "x, y and z must be FLOAT32 (7) or FLOAT64 (8); any other field is ignored"},
    MessageFault{malformed_field_bounds, "the driver describes a field that lies outside of its points",
                 "x, y and z must lie inside of a point; any other field is ignored"},
    MessageFault{malformed_xyz, "the points are not Cartesian, or this is no topic of points", another_topic},
    MessageFault{malformed_point_step, "the driver describes points that are empty or larger than any LiDAR's",
                 another_topic},
    MessageFault{malformed_row_step, "the driver computes row_step in another way than ROS 2 says",
                 "one without padding is ignored; with padding the driver must write width * point_step + padding"},
    MessageFault{malformed_cloud_size, "the cloud is larger than the configuration expects",
                 "raise lidar.max_points, which takes 64 bytes a point, or configure a topic of one revolution"},
    MessageFault{malformed_cloud_data, truncated,
                 "look for lost fragments (net.core.rmem_max); if it stays, the driver's header is wrong"},
    MessageFault{malformed_cloud_layout, "the bytes of the points are not what the header says",
                 "correct is_bigendian, or the offsets and datatypes of x, y and z, in the driver or its settings"},
    MessageFault{malformed_image_size, "the header has no size, or one that no camera has",
                 "configure the topic of a camera that is running"},
    MessageFault{malformed_encoding, "calibd does not convert this encoding",
                 "have the driver publish one of those (many have a setting such as pixel_format), or write its "
                 "compressed topic, which ends in /compressed, as camera.image"},
    MessageFault{malformed_step, "the driver computes step in another way than ROS 2 says",
                 "one without padding is ignored; with padding the driver must write the bytes of a row + padding"},
    MessageFault{malformed_image_data, truncated,
                 "look for lost fragments (net.core.rmem_max); if it stays, encoding, step or size are wrong"},
    MessageFault{malformed_compressed_format, "it is a video stream, an animation, or a JPEG of a rare kind",
                 other_jpeg},
    MessageFault{malformed_compressed_size, "the data is empty, or larger than any image of its size is", other_jpeg},
    MessageFault{malformed_compressed_dimensions, "the data has no size in its header, or one that no camera has",
                 other_jpeg},
    MessageFault{malformed_compressed_scans, "the JPEG is progressive with more scans than any encoder writes",
                 other_jpeg},
    MessageFault{malformed_compressed_metadata, "the PNG carries more text or profiles than an image needs",
                 other_jpeg},
    MessageFault{malformed_compressed_data, "the data was cut short, or is damaged",
                 "look for lost fragments (net.core.rmem_max); configure the raw image topic if it stays"},
    MessageFault{malformed_depth_encoding, "this topic carries a depth image",
                 "write the camera's image topic as camera.image; depth belongs into depth.image"},
    MessageFault{malformed_disparity_scale, "the publisher does not know its camera's focal length or baseline",
                 "calibrate the stereo camera, or use source: stereo with its two images and baseline_m"},
    MessageFault{malformed_disparity_range, "the publisher does not fill in the range of its disparities",
                 nothing_to_do},
    MessageFault{malformed_disparity_sign, "the publisher has left and right exchanged, or another sign",
                 "exchange the two images of the stereo node, or use source: stereo with them"},
    MessageFault{malformed_valid_window, "the publisher computes it before its image has a size", nothing_to_do},
    MessageFault{malformed_intrinsics, "the driver's calibration file is damaged, or for another unit", no_camera_info},
    MessageFault{malformed_uncalibrated, "the driver has no calibration file", no_camera_info},
    MessageFault{malformed_distortion, "the driver's lens model is another one than its name says, or unknown",
                 no_camera_info},
    MessageFault{
        malformed_roi, "roi and binning are not those of the full image in width and height",
        "write camera.info_reduction: ignored if the driver has applied them already; else leave camera.info out"},
    MessageFault{malformed_angular_velocity, "the sensor does not measure it, or it is not in rad/s",
                 "configure a topic with a turn rate, or leave motion out"},
    MessageFault{image_size_mismatch, "the driver publishes another resolution or a part of the sensor",
                 "correct the size and the intrinsics in the configuration"},
    MessageFault{image_bits, "the camera has fewer than 16 bits, and its driver does not shift them up",
                 "write camera.bits"},
    MessageFault{out_of_memory, "calibd has too little memory for such messages",
                 "give calibd more (MemoryMax=), or smaller samples"},
};
constexpr MessageFault unknown{internal_error, "the message cannot be used", "report it with a recording of the topic"};

}  // namespace

const MessageFault& message_fault(ErrorCode code) {
  const auto found = std::ranges::find(faults, code, &MessageFault::code);
  return found == faults.end() ? unknown : *found;
}

}  // namespace calib
