#pragma once

#include "calib/camera.hpp"
#include "calib/geometry.hpp"

namespace calib::vehicle {

/// Where the sensors of the simulated vehicle sit.
struct Rig {
  Camera camera;  // left and right alike, rectified
  double baseline_m = 0.54;
  RigidTransform T_vehicle_camera = RigidTransform::Identity();  // of the left camera's optical frame
  RigidTransform T_camera_lidar = RigidTransform::Identity();    // before any knock

  /// A rig like KITTI's; the field of view across is the same for every image size.
  [[nodiscard]] static Result<Rig> make(int width, int height);
};

}  // namespace calib::vehicle
