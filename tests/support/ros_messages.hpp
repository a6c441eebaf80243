#pragma once

#include <array>
#include <cstdint>
#include <cstring>
#include <string>
#include <vector>

#include "ros2.h"

namespace calib::test {

/// ROS 2 messages that own what they point to, in buffers of exactly their size, so that a sanitizer sees
/// every byte read too far. `raw()` points into `*this`. As made here, each is good; tests then spoil one
/// thing.

using Octets = std::vector<std::uint8_t>;

inline dds_sequence_octet sequence(Octets& bytes) {
  return {static_cast<std::uint32_t>(bytes.size()), static_cast<std::uint32_t>(bytes.size()), bytes.data(), false};
}

struct ImageMessage {
  std::int32_t sec = 12;
  std::uint32_t nanosec = 345;
  std::uint32_t width = 6, height = 4, step = 6;
  std::string encoding = "mono8";
  std::uint8_t is_bigendian = 0;
  Octets data = Octets(24, 7);

  sensor_msgs_msg_dds__Image_ raw() {
    return {{{sec, nanosec}, frame_id_.data()}, height, width, encoding.data(), is_bigendian, step, sequence(data)};
  }

 private:
  std::string frame_id_ = "camera";
};

struct CompressedImageMessage {
  std::int32_t sec = 12;
  std::uint32_t nanosec = 345;
  std::string format = "jpeg";
  Octets data;

  sensor_msgs_msg_dds__CompressedImage_ raw() {
    return {{{sec, nanosec}, frame_id_.data()}, format.data(), sequence(data)};
  }

 private:
  std::string frame_id_ = "camera";
};

/// Disparities 1, 2, .. 24 of a camera with f t = 100 pixels times metres.
struct DisparityMessage {
  ImageMessage image;
  std::int32_t sec = 13;
  float f = 200, t = 0.5F, min_disparity = 0, max_disparity = 0, delta_d = 0.0625F;
  std::uint32_t window_x = 0, window_y = 0, window_width = 0, window_height = 0;

  DisparityMessage() {
    image.step = 24;
    image.encoding = "32FC1";
    image.data.resize(96);
    for (std::uint32_t i = 0; i < 24; ++i) {
      const float disparity = 1.0F + static_cast<float>(i);
      std::memcpy(image.data.data() + 4 * i, &disparity, 4);
    }
  }

  stereo_msgs_msg_dds__DisparityImage_ raw() {
    const auto picture = image.raw();
    auto header = picture.header;
    header.stamp.sec = sec;
    return {header,        picture,       f,      t, {window_x, window_y, window_height, window_width, false},
            min_disparity, max_disparity, delta_d};
  }
};

struct CameraInfoMessage {
  std::int32_t sec = 12;
  std::uint32_t nanosec = 345;
  std::uint32_t width = 640, height = 480;
  std::string distortion_model = "plumb_bob";
  std::vector<double> d{-0.3, 0.1, 0.001, -0.002, 0.01};
  std::array<double, 9> k{500, 0, 320, 0, 510, 240, 0, 0, 1};
  std::array<double, 9> r{};
  std::array<double, 12> p{500, 0, 320, 0, 0, 510, 240, 0, 0, 0, 1, 0};
  std::uint32_t binning_x = 0, binning_y = 0;
  std::uint32_t roi_x = 0, roi_y = 0, roi_width = 0, roi_height = 0;

  sensor_msgs_msg_dds__CameraInfo_ raw() {
    sensor_msgs_msg_dds__CameraInfo_ message{};
    message.header = {{sec, nanosec}, frame_id_.data()};
    message.height = height;
    message.width = width;
    message.distortion_model = distortion_model.data();
    const auto length = static_cast<std::uint32_t>(d.size());
    message.d = {length, length, d.data(), false};
    std::memcpy(message.k, k.data(), sizeof(message.k));
    std::memcpy(message.r, r.data(), sizeof(message.r));
    std::memcpy(message.p, p.data(), sizeof(message.p));
    message.binning_x = binning_x;
    message.binning_y = binning_y;
    message.roi = {roi_x, roi_y, roi_height, roi_width, false};
    return message;
  }

 private:
  std::string frame_id_ = "camera";
};

/// 0.2, -0.3, 0.6 rad/s: 0.7 about its own axis.
struct ImuMessage {
  std::int32_t sec = 12;
  std::uint32_t nanosec = 345;
  std::array<double, 3> angular_velocity{0.2, -0.3, 0.6};
  double first_covariance = 0;

  sensor_msgs_msg_dds__Imu_ raw() {
    sensor_msgs_msg_dds__Imu_ message{};
    message.header = {{sec, nanosec}, frame_id_.data()};
    message.orientation.w = 1;
    message.angular_velocity = {angular_velocity[0], angular_velocity[1], angular_velocity[2]};
    message.angular_velocity_covariance[0] = first_covariance;
    message.linear_acceleration.z = 9.8;
    return message;
  }

 private:
  std::string frame_id_ = "imu";
};

/// The same turn.
struct OdometryMessage {
  std::int32_t sec = 12;
  std::uint32_t nanosec = 345;
  std::array<double, 3> angular_velocity{0.2, -0.3, 0.6};

  nav_msgs_msg_dds__Odometry_ raw() {
    nav_msgs_msg_dds__Odometry_ message{};
    message.header = {{sec, nanosec}, frame_id_.data()};
    message.child_frame_id = child_frame_id_.data();
    message.pose.pose.position.x = 5;
    message.pose.pose.orientation.w = 1;
    message.pose.covariance[35] = 0.5;
    message.twist.twist.linear.x = 8;
    message.twist.twist.angular = {angular_velocity[0], angular_velocity[1], angular_velocity[2]};
    message.twist.covariance[35] = 0.25;
    return message;
  }

 private:
  std::string frame_id_ = "odom", child_frame_id_ = "base_link";
};

struct CloudField {
  std::string name;
  std::uint32_t offset = 0;
  std::uint8_t datatype = 7;  // FLOAT32
  std::uint32_t count = 1;
};

/// Two rows of three points with x, y, z, intensity as FLOAT32; point i is (1 + i, 2, 3) with intensity i.
struct CloudMessage {
  std::int32_t sec = 12;
  std::uint32_t nanosec = 345;
  std::uint32_t width = 3, height = 2, point_step = 16, row_step = 48;
  std::vector<CloudField> fields{{"x", 0}, {"y", 4}, {"z", 8}, {"intensity", 12}};
  bool is_bigendian = false;
  Octets data = Octets(96);

  CloudMessage() {
    for (std::uint32_t i = 0; i < 6; ++i) {
      const float point[4] = {1.0F + static_cast<float>(i), 2.0F, 3.0F, static_cast<float>(i)};
      std::memcpy(data.data() + 16 * i, point, sizeof(point));
    }
  }

  sensor_msgs_msg_dds__PointCloud2_ raw() {
    raw_fields_.clear();
    for (CloudField& field : fields)
      raw_fields_.push_back({field.name.data(), field.offset, field.datatype, field.count});
    const auto count = static_cast<std::uint32_t>(raw_fields_.size());
    return {{{sec, nanosec}, frame_id_.data()},
            height,
            width,
            {count, count, raw_fields_.data(), false},
            is_bigendian,
            point_step,
            row_step,
            sequence(data),
            true};
  }

 private:
  std::string frame_id_ = "lidar";
  std::vector<sensor_msgs_msg_dds__PointField_> raw_fields_;
};

}  // namespace calib::test
