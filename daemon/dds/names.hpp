#pragma once

#include <string>
#include <string_view>
#include <utility>

#include "calib/result.hpp"

namespace calib {

/// The name on DDS of a ROS topic: `/lidar/points` gives `rt/lidar/points`, and `dds:NAME` gives NAME unchanged. Fails
/// with `bad_topic` when ROS 2 (or, for a raw name, Cyclone) does not allow the name.
[[nodiscard]] Result<std::string> dds_topic_name(std::string_view topic);

/// The inverse, for any name on DDS.
[[nodiscard]] std::string ros_topic_name(std::string_view dds_topic);

/// `sensor_msgs::msg::dds_::Image_` gives `sensor_msgs/msg/Image`; a name that is not ROS 2's stays as it is.
[[nodiscard]] std::string ros_type_name(std::string_view dds_type);

/// What binning and roi of a CameraInfo mean, of which drivers have different opinions.
enum class InfoReduction {
  as_specified,  // width, height, K and P are of the full sensor, as ROS says
  ignored,       // all of them are of the image already
  size_only      // width and height are of the full sensor, K and P of the image
};
/// The name of a topic of CameraInfo, and how its binning and roi are read.
struct CameraInfoTopic {
  std::string name;
  InfoReduction reduction = InfoReduction::as_specified;
};

/// A topic of depth and its message: sensor_msgs/Image (16UC1 or 32FC1) or stereo_msgs/DisparityImage.
enum class DepthMessage { image, disparity };
struct DepthTopic {
  std::string name;
  DepthMessage message = DepthMessage::image;
};

/// A topic of the vehicle's angular velocity and its message: sensor_msgs/Imu or nav_msgs/Odometry.
enum class MotionMessage { imu, odometry };
struct MotionTopic {
  std::string name;
  MotionMessage message = MotionMessage::imu;
};

/// Whether a topic carries CompressedImage: by ROS convention its name ends in `/compressed`.
[[nodiscard]] bool is_compressed_topic(std::string_view topic);

/// Whether `name` can be a network interface or an address (or `auto`): 1 .. 64 letters, digits and `. : _ @ -`. Such a
/// name needs no escaping in Cyclone's XML.
[[nodiscard]] bool is_interface_name(std::string_view name);

/// Whether `text` can be a host name or an address: 1 .. 253 letters, digits and `. : -`. It needs no escaping either.
[[nodiscard]] bool is_peer_address(std::string_view text);

}  // namespace calib
