#pragma once

#include <optional>
#include <string>

#include "vehicle/vehicle.hpp"

namespace calib::vehicle {

/// ROS names.
struct Topics {
  std::string left_image = "/camera/left/image", right_image = "/camera/right/image";
  std::string left_info = "/camera/left/camera_info", right_info = "/camera/right/camera_info";
  std::string cloud = "/lidar/points";
  std::string depth;   // of the left camera; empty: none is published
  std::string motion;  // likewise
};

/// The message that carries depth: Image of metres or millimetres, or DisparityImage.
enum class DepthAs { metres, millimetres, disparity };
/// The message with the turn rate of the vehicle.
enum class MotionAs { imu, odometry };

struct PublisherOptions {
  int domain = 0;
  std::string interface = "lo";
  bool best_effort = false;
  Topics topics;
  DepthAs depth_as = DepthAs::metres;
  MotionAs motion_as = MotionAs::imu;
};

/// Publishes frames as ROS 2 drivers do: Image (mono8), CameraInfo and PointCloud2 (x, y, z, intensity as
/// 32-bit floats), XCDR1, KEEP_LAST 5, VOLATILE. Cyclone is configured from the options alone, not from
/// CYCLONEDDS_URI.
class Publisher {
 public:
  /// One per domain and process. Fails with `dds_failed`.
  [[nodiscard]] static Result<Publisher> open(const PublisherOptions& options, const Vehicle& vehicle);

  /// The images that there are, each with its camera info; the stamp is the images'.
  [[nodiscard]] Result<void> publish(const Image& left, const std::optional<Image>& right);
  [[nodiscard]] Result<void> publish(const LidarScan& scan);
  /// Depth along the left camera's axis, with the image's stamp; nothing when no topic was asked for. Fails also with
  /// `no_depth`.
  [[nodiscard]] Result<void> publish_depth(Timestamp stamp, const std::vector<float>& depth_m);

  /// Nothing when no topic was asked for.
  [[nodiscard]] Result<void> publish_motion(Timestamp stamp, const Eigen::Vector3d& angular_velocity_rad_s);

  Publisher(Publisher&& other) noexcept;
  Publisher& operator=(Publisher&&) = delete;
  ~Publisher();

 private:
  explicit Publisher(const Vehicle& vehicle) : vehicle_(vehicle) {}
  [[nodiscard]] Result<void> publish_info(int writer, Timestamp stamp, double baseline_m,
                                          const Eigen::Matrix3d& R_rectified_camera);

  int domain_ = 0;  // entity handles; 0 when there is none
  int left_ = 0, right_ = 0, left_info_ = 0, right_info_ = 0, cloud_ = 0, depth_ = 0, motion_ = 0;
  DepthAs depth_as_ = DepthAs::metres;
  MotionAs motion_as_ = MotionAs::imu;
  Vehicle vehicle_;
};

}  // namespace calib::vehicle
