#include "vehicle/rig.hpp"

#include <cmath>

namespace calib::vehicle {

Result<Rig> Rig::make(int width, int height) {
  const double focal = 0.5812 * width;
  auto camera =
      Camera::make(CameraModel::rectified, width, height, {focal, focal, 0.5 * width - 2.3, std::round(0.47 * height)});
  if (!camera) return propagate(camera);
  Rig rig{.camera = *std::move(camera)};

  // Optical axes (right, down, forward) in the vehicle's (forward, left, up).
  Eigen::Matrix3d R_vehicle_optical;
  R_vehicle_optical << 0, 0, 1, -1, 0, 0, 0, -1, 0;
  rig.T_vehicle_camera.linear() =
      R_vehicle_optical * Eigen::AngleAxisd(-0.012, Eigen::Vector3d::UnitX()).toRotationMatrix();
  rig.T_vehicle_camera.translation() = Eigen::Vector3d(1.6, 0.27, 1.65);

  // The LiDAR 8 cm above the camera, 27 cm behind it and a little aside, not quite upright and not quite
  // straight ahead.
  rig.T_camera_lidar.linear() = R_vehicle_optical.transpose();
  rig.T_camera_lidar.translation() = Eigen::Vector3d(-0.06, -0.08, -0.27);
  Vector6 mounting;
  mounting << -0.0148, 0.0021, 0.0075, 0, 0, 0;
  rig.T_camera_lidar = rig.T_camera_lidar * perturbation(mounting);
  return rig;
}

Result<Rig> Rig::make_unrectified(int width, int height) {
  auto rig = make(width, height);
  if (!rig) return rig;
  const Camera& straight = rig->camera;
  auto bent =
      Camera::make(CameraModel::plumb_bob, width, height, {straight.fx(), straight.fy(), straight.cx(), straight.cy()},
                   {-0.12, 0.02, 0.0005, -0.0003, 0});
  if (!bent) return propagate(bent);
  rig->camera = *std::move(bent);
  Vector6 left, right;
  left << 0.006, -0.004, 0.008, 0, 0, 0;
  right << -0.007, 0.009, -0.005, 0, 0, 0;
  rig->R_rectified_left = perturbation(left).linear();
  rig->R_rectified_right = perturbation(right).linear();
  return rig;
}

RigidTransform Rig::T_left_right() const {
  return RigidTransform(R_rectified_left.transpose()) * Eigen::Translation3d(baseline_m, 0, 0) *
         RigidTransform(R_rectified_right);
}

}  // namespace calib::vehicle
