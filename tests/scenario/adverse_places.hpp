#pragma once

#include <algorithm>
#include <optional>
#include <vector>

#include "support/simulated_drive.hpp"
#include "vehicle/roadside.hpp"

namespace calib::test {

/// What a vehicle's sensors see at one moment; depth as it is.
struct Shot {
  vehicle::Rendering rendering;
  LidarScan scan;
};

enum class PlaceKind { street, country, walls, field };

/// A place that the vehicle drives through: shots far enough apart to have little in common.
class AdversePlace {
 public:
  AdversePlace(PlaceKind kind, std::uint64_t seed, int shots) : kind_(kind), scene_(seed), seed_(seed) {
    for (int i = 0; i < shots; ++i) shots_.push_back(take(i));
  }

  [[nodiscard]] PlaceKind kind() const { return kind_; }
  [[nodiscard]] const vehicle::Rig& rig() const { return rig_; }
  [[nodiscard]] const Shot& shot(int index) const { return shots_[static_cast<std::size_t>(index) % shots_.size()]; }
  [[nodiscard]] int shots() const { return static_cast<int>(shots_.size()); }

 private:
  static constexpr int width = 320, height = 96;

  [[nodiscard]] Shot take(int index) {
    std::optional<vehicle::Roadside> roadside;
    vehicle::Mesh bare;
    std::vector<vehicle::Instance> instances;
    RigidTransform T_world_vehicle = RigidTransform::Identity();
    if (kind_ == PlaceKind::street) {
      instances = scene_.instances(5.0 * index);
      T_world_vehicle = scene_.T_world_vehicle(5.0 * index);
    } else if (kind_ == PlaceKind::country) {
      roadside.emplace(vehicle::mix(seed_, index));
      roadside->fill(-0.5F * roadside->half_width());
      instances = {{&roadside->mesh(), RigidTransform::Identity()}};
      T_world_vehicle = roadside->pose(0, -0.5F * roadside->half_width(), 0, 0).cast<double>();
    } else {
      bare = empty_place(index);
      instances = {{&bare, RigidTransform::Identity()}};
      vehicle::Random random(vehicle::mix(seed_, index, 2));
      T_world_vehicle = knock(random.gaussian(), random.gaussian(), 3 * random.gaussian(), random.uniform(0, 5),
                              random.uniform(-2, 2));
    }
    const RigidTransform T_world_camera = T_world_vehicle * rig_.T_vehicle_camera;
    const vehicle::LidarModel lidar{.azimuth_step_deg = 0.7, .field_of_view_deg = 100};
    return {vehicle::render(scene_, instances, rig_.camera, T_world_camera),
            vehicle::scan(scene_, instances, lidar, T_world_camera * rig_.T_camera_lidar, vehicle::mix(seed_, index))};
  }

  /// A field, or a yard of blank walls.
  [[nodiscard]] vehicle::Mesh empty_place(int index) const {
    vehicle::Random random(vehicle::mix(seed_, index, 1));
    vehicle::Mesh mesh;
    const vehicle::Surface ground{vehicle::Material::ground, 1}, wall{vehicle::Material::plain, 2};
    mesh.add_quad({-50, -150, 0}, {250, -150, 0}, {250, 150, 0}, {-50, 150, 0}, ground);
    if (kind_ == PlaceKind::field) return mesh;
    const float left = random.uniform(4, 8), right = -random.uniform(4, 8), end = random.uniform(15, 45);
    mesh.add_quad({end, left, 0}, {-50, left, 0}, {-50, left, 6}, {end, left, 6}, wall);
    mesh.add_quad({-50, right, 0}, {end, right, 0}, {end, right, 6}, {-50, right, 6}, wall);
    mesh.add_quad({end, right, 0}, {end, left, 0}, {end, left, 6}, {end, right, 6}, wall);
    return mesh;
  }

  PlaceKind kind_;
  vehicle::Scene scene_;
  vehicle::Rig rig_ = require_ok(vehicle::Rig::make(width, height));
  std::uint64_t seed_;
  std::vector<Shot> shots_;
};

/// How far off `T_camera_lidar` is: the mean angle (rad) between where `points` (LiDAR frame, 5 to 50 m away) are seen
/// and where the extrinsic puts them.
inline double mean_angle_off(const RigidTransform& T_camera_lidar, const RigidTransform& T_true, const LidarScan& scan,
                             const Camera& camera) {
  double sum = 0;
  int count = 0;
  for (std::size_t i = 0; i < scan.points.size(); i += 7) {
    const LidarPoint& point = scan.points[i];
    const Eigen::Vector3d truth = T_true * Eigen::Vector3d(point.x_m, point.y_m, point.z_m);
    if (truth.norm() < 5 || truth.norm() > 50 || !camera.project(truth)) continue;
    const Eigen::Vector3d guess = T_camera_lidar * Eigen::Vector3d(point.x_m, point.y_m, point.z_m);
    sum += std::atan2(truth.cross(guess).norm(), truth.dot(guess));
    ++count;
  }
  return count == 0 ? 0 : sum / count;
}

}  // namespace calib::test
