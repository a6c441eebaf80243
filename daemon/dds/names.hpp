#pragma once

#include <string>
#include <string_view>

#include "calib/result.hpp"

namespace calib {

/// The DDS topic that carries a ROS topic: `/lidar/points` gives `rt/lidar/points`, `dds:NAME` gives NAME as
/// it is. Fails with `bad_topic` when the name is not one that ROS 2 (or, for a raw name, Cyclone) allows.
[[nodiscard]] Result<std::string> dds_topic_name(std::string_view topic);

/// Its inverse, for any name that may be heard on DDS.
[[nodiscard]] std::string ros_topic_name(std::string_view dds_topic);

/// `sensor_msgs::msg::dds_::Image_` gives `sensor_msgs/msg/Image`; a name that is not ROS 2's stays as it is.
[[nodiscard]] std::string ros_type_name(std::string_view dds_type);

/// A topic of depth, and the message that it carries: sensor_msgs/Image (16UC1 or 32FC1) or stereo_msgs/DisparityImage.
enum class DepthMessage { image, disparity };
struct DepthTopic {
  std::string name;
  DepthMessage message = DepthMessage::image;
};

/// A topic that tells how fast the vehicle turns, and the message that it carries: sensor_msgs/Imu or
/// nav_msgs/Odometry.
enum class MotionMessage { imu, odometry };
struct MotionTopic {
  std::string name;
  MotionMessage message = MotionMessage::imu;
};

/// Whether a topic carries CompressedImage, which ROS says by its last part.
[[nodiscard]] bool is_compressed_topic(std::string_view topic);

/// Whether `name` can be a network interface (or `auto`, the system's choice): 1 .. 64 characters of letters,
/// digits and `. : _ @ -`. So it needs no escaping where it goes into Cyclone's XML.
[[nodiscard]] bool is_interface_name(std::string_view name);

}  // namespace calib
