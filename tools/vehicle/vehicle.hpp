#pragma once

#include <functional>
#include <optional>
#include <vector>

#include "calib/camera.hpp"
#include "calib/frame.hpp"
#include "calib/geometry.hpp"
#include "dataset/recording.hpp"
#include "vehicle/lidar.hpp"

namespace calib::vehicle {

/// What the sensors see at one moment, and for a simulated camera of any model the truth.
struct SeenFrame : FramePair {
  std::vector<float> range_m = {};  // along the ray of every pixel of `image`, infinite in the sky; else empty
  std::vector<float> depth_m = {};  // along the optical axis, for simulated cameras that look ahead; else empty
};

/// A vehicle with a camera and a LiDAR, simulated or recorded.
struct Vehicle {
  Camera camera;          // of both images
  double baseline_m = 0;  // 0: no right camera
  /// How each camera is turned in the rectified pair.
  Eigen::Matrix3d R_rectified_left = Eigen::Matrix3d::Identity(), R_rectified_right = Eigen::Matrix3d::Identity();
  RigidTransform T_camera_lidar;  // before the LiDAR moves
  /// What the sensors see in frame `index`, `t_s` after the start, by a LiDAR that has moved by `motion` in
  /// its own frame. Stamps are not set.
  std::function<Result<SeenFrame>(std::size_t index, double t_s, const RigidTransform& motion)> frame;
  /// How long after its images a frame's scan is taken, by a LiDAR that is not triggered with the cameras.
  double cloud_late_s = 0;
  /// How it turns at a time after the start: rad/s about its own axes. Recorded vehicles do not know.
  std::function<Eigen::Vector3d(double t_s)> angular_velocity = {};
};

struct Simulation {
  std::uint64_t seed = 1;
  int width = 960, height = 288;
  std::optional<Camera> camera;  // of any model, instead of the rectified stereo camera of that size
  bool unrectified = false;      // the stereo camera as lenses and mounts are, instead of rectified
  bool dark = false;             // night without lights: the cameras see next to nothing, the LiDAR as much as ever
  LidarModel lidar;
  double cloud_late_s = 0;
  double weave_rad = 0;  // the heading swings to both sides by so much, once in `weave_period_s`
};
constexpr double weave_period_s = 6;

/// Drives through the endless street of a seed. A frame depends on the simulation, its index and its time
/// alone.
[[nodiscard]] Result<Vehicle> simulated_vehicle(const Simulation& simulation);

/// Drives as recorded, from the beginning again after the last frame. Without a stereo camera whose images are
/// rectified it has one camera; where `needs_stereo` that fails with `no_right_images`.
[[nodiscard]] Result<Vehicle> recorded_vehicle(const Recording& recording, bool needs_stereo = true);

}  // namespace calib::vehicle
