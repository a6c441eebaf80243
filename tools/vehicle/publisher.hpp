#pragma once

#include <string>

#include "calib/camera.hpp"
#include "calib/frame.hpp"
#include "calib/result.hpp"

namespace calib::vehicle {

/// ROS names.
struct Topics {
  std::string left_image = "/camera/left/image", right_image = "/camera/right/image";
  std::string left_info = "/camera/left/camera_info", right_info = "/camera/right/camera_info";
  std::string cloud = "/lidar/points";
};

struct PublisherOptions {
  int domain = 0;
  std::string interface = "lo";
  bool best_effort = false;
  Topics topics;
};

/// Publishes frames as ROS 2 drivers do: Image (mono8), CameraInfo and PointCloud2 (x, y, z, intensity as
/// 32-bit floats), XCDR1, KEEP_LAST 5, VOLATILE. Cyclone is configured from the options alone, not from
/// CYCLONEDDS_URI.
class Publisher {
 public:
  /// One per domain and process. Fails with `dds_failed`.
  [[nodiscard]] static Result<Publisher> open(const PublisherOptions& options, const Camera& camera,
                                              double baseline_m);

  /// Both images, each with its camera info; the stamp is the images'.
  [[nodiscard]] Result<void> publish(const Image& left, const Image& right);
  [[nodiscard]] Result<void> publish(const LidarScan& scan);

  Publisher(Publisher&& other) noexcept;
  Publisher& operator=(Publisher&&) = delete;
  ~Publisher();

 private:
  Publisher(const Camera& camera, double baseline_m) : camera_(camera), baseline_m_(baseline_m) {}
  [[nodiscard]] Result<void> publish_info(int writer, Timestamp stamp, double baseline_m);

  int domain_ = 0;  // entity handles; 0 when there is none
  int left_ = 0, right_ = 0, left_info_ = 0, right_info_ = 0, cloud_ = 0;
  Camera camera_;
  double baseline_m_;
};

}  // namespace calib::vehicle
