#pragma once

#include <cmath>
#include <optional>
#include <span>
#include <vector>

#include "calib/features.hpp"
#include "support/support.hpp"
#include "vehicle/lidar.hpp"
#include "vehicle/render.hpp"
#include "vehicle/rig.hpp"

namespace calib::test {

/// A drive through the simulated street with a depth source that makes no mistake, so that the truth of an extrinsic
/// is the LiDAR's place and nothing else. A LiDAR that has moved by `motion` in its own frame measures from there.
class SimulatedDrive {
 public:
  explicit SimulatedDrive(std::uint64_t seed, int width = 640, int height = 192,
                          const vehicle::LidarModel& lidar = {.azimuth_step_deg = 0.25, .field_of_view_deg = 110})
      : scene_(seed), rig_(require_ok(vehicle::Rig::make(width, height))), lidar_(lidar) {}

  [[nodiscard]] const Camera& camera() const { return rig_.camera; }
  [[nodiscard]] const RigidTransform& T_camera_lidar() const { return rig_.T_camera_lidar; }

  [[nodiscard]] DepthMap depth(int index) {
    const auto seen = rendering(index);
    DepthMap depth{seen.width, seen.height, {}};
    for (const float depth_m : seen.depth_m) depth.inverse_depth.push_back(std::isfinite(depth_m) ? 1 / depth_m : 0);
    return depth;
  }

  [[nodiscard]] FramePair pair(int index, const RigidTransform& motion = RigidTransform::Identity()) {
    return {vehicle::expose(rendering(index), 0.9F, index), std::nullopt, scan(index, motion)};
  }

  [[nodiscard]] LidarScan scan(int index, const RigidTransform& motion = RigidTransform::Identity()) {
    const double t_s = time_s(index);
    LidarScan scan =
        vehicle::scan(scene_, scene_.instances(t_s), lidar_, T_world_camera(t_s) * rig_.T_camera_lidar * motion, index);
    scan.stamp = std::chrono::seconds(index);
    return scan;
  }

  /// What a monitor keeps that takes the extrinsic for what it was before the LiDAR moved.
  [[nodiscard]] FeatureSet features(int index, const RigidTransform& motion = RigidTransform::Identity()) {
    return require_ok(make_features(pair(index, motion), depth(index), camera(), T_camera_lidar()));
  }
  [[nodiscard]] std::vector<FeatureSet> features_of(int count, const RigidTransform& motion) {
    std::vector<FeatureSet> frames;
    for (int i = 0; i < count; ++i) frames.push_back(features(i, motion));
    return frames;
  }

 private:
  [[nodiscard]] vehicle::Rendering rendering(int index) {
    return vehicle::render(scene_, scene_.instances(time_s(index)), rig_.camera, T_world_camera(time_s(index)));
  }
  static double time_s(int index) { return 5.0 * index; }
  [[nodiscard]] RigidTransform T_world_camera(double t_s) const {
    return scene_.T_world_vehicle(t_s) * rig_.T_vehicle_camera;
  }

  vehicle::Scene scene_;
  vehicle::Rig rig_;
  vehicle::LidarModel lidar_;
};

/// As `Frames` wants them.
inline std::vector<const FeatureSet*> pointers(std::span<const FeatureSet> frames) {
  std::vector<const FeatureSet*> all;
  for (const FeatureSet& frame : frames) all.push_back(&frame);
  return all;
}

/// How far the LiDAR moved: rotations in degrees, translations in metres.
inline RigidTransform knock(double roll_deg, double pitch_deg, double yaw_deg, double x_m = 0, double y_m = 0,
                            double z_m = 0) {
  Vector6 delta;
  delta << roll_deg * radians_per_degree, pitch_deg * radians_per_degree, yaw_deg * radians_per_degree, x_m, y_m, z_m;
  return perturbation(delta);
}

}  // namespace calib::test
