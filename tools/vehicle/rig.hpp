#pragma once

#include "calib/camera.hpp"
#include "calib/geometry.hpp"

namespace calib::vehicle {

/// Where the sensors of the simulated vehicle sit.
struct Rig {
  Camera camera;  // left and right alike
  double baseline_m = 0.54;
  /// How each camera is turned in the rectified pair: not at all when the pair is rectified as it is.
  Eigen::Matrix3d R_rectified_left = Eigen::Matrix3d::Identity(), R_rectified_right = Eigen::Matrix3d::Identity();
  RigidTransform T_vehicle_camera = RigidTransform::Identity();  // of the left camera's optical frame
  RigidTransform T_camera_lidar = RigidTransform::Identity();    // before any knock

  /// A rig like KITTI's; the field of view across is the same for every image size.
  [[nodiscard]] static Result<Rig> make(int width, int height);
  /// The same with lenses that bend, in cameras that nobody could mount quite straight.
  [[nodiscard]] static Result<Rig> make_unrectified(int width, int height);

  [[nodiscard]] RigidTransform T_left_right() const;
};

}  // namespace calib::vehicle
