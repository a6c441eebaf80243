#pragma once

#include <vector>

#include "calib/frame.hpp"
#include "vehicle/scene.hpp"

namespace calib::vehicle {

/// A spinning LiDAR of 64 beams from 2 degrees above to 24.3 below its horizon (one third of a degree apart
/// in the upper half, half a degree in the lower: a Velodyne HDL-64E).
struct LidarModel {
  double azimuth_step_deg = 0.2;
  double field_of_view_deg = 360;  // centred on x
  float max_range_m = 80;
  float range_sigma_m = 0.02f;
  float dropout = 0.02f;  // share of returns that get lost whatever they hit
  bool ideal = false;     // no noise, nothing lost
};

/// One revolution of the LiDAR at `T_world_lidar` (x forward, y left, z up), everything at one instant, in
/// the order of the azimuth. `key` picks noise and losses; stamp left at 0. Reflectance in [0, 1].
[[nodiscard]] LidarScan scan(const Scene& scene, const std::vector<Instance>& instances, const LidarModel& model,
                             const RigidTransform& T_world_lidar, std::uint64_t key);

}  // namespace calib::vehicle
