#pragma once

#include <array>

#include "calib/frame.hpp"
#include "calib/geometry.hpp"

namespace calib::vehicle {

/// How the LiDAR gets moved in its own frame: at once by a knock at `start_s`, or slowly from then on. Drive
/// time. The extrinsic's truth is then `T_camera_lidar * perturbation(at(t_s))`.
struct Knock {
  std::array<double, 3> rotation_deg{}, translation_cm{};  // roll, pitch, yaw; x, y, z
  std::array<double, 3> drift_deg_per_minute{}, drift_cm_per_minute{};
  double start_s = 0;

  /// Parameters of the motion so far (rad, m); zero before `start_s`.
  [[nodiscard]] Vector6 at(double t_s) const;
};

/// The scan as the LiDAR would have measured it after moving by `motion` in its own frame: p becomes
/// motion^-1 p.
void move_lidar(LidarScan& scan, const RigidTransform& motion);

}  // namespace calib::vehicle
