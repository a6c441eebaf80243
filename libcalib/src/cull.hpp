#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "calib/features.hpp"

namespace calib {

/// Whether some extrinsic within the bounds can bring a point (LiDAR frame, m) into view.
class Cull {
 public:
  Cull(const FeaturePlanes& planes, const RigidTransform& T_camera_lidar, const SearchBounds& bounds)
      : T_(T_camera_lidar.cast<float>()),
        wide_(planes.grid.xi != 0),
        max_angle_(static_cast<float>(planes.max_angle_rad)) {
    // The largest angle of Rx Ry Rz with each angle within the bounds, and how far a point can be shifted: by the
    // translation, and because the LiDAR turns about its own origin and not about the camera's.
    const double half = std::min(bounds.rotation_rad, 1.0) / 2;
    turn_ = static_cast<float>(bounds.rotation_rad >= 1
                                   ? std::numbers::pi
                                   : 2 * std::acos(std::pow(std::cos(half), 3) - std::pow(std::sin(half), 3)));
    moved_ = static_cast<float>(std::sqrt(3.0) * bounds.translation_m + turn_ * T_camera_lidar.translation().norm());
    still_ = static_cast<float>(std::numbers::pi - max_angle_);
    // A pinhole's view is where all four of these inward normals have p.normal >= 0. A bearing that comes into view by
    // an angle is no further than this angle outside each of them.
    const BearingGrid& grid = planes.grid;
    const auto width = static_cast<float>(grid.width), height = static_cast<float>(grid.height);
    sides_ = {Eigen::Vector3f(grid.fx, 0, grid.cx + 0.5F).normalized(),
              Eigen::Vector3f(-grid.fx, 0, width - 0.5F - grid.cx).normalized(),
              Eigen::Vector3f(0, grid.fy, grid.cy + 0.5F).normalized(),
              Eigen::Vector3f(0, -grid.fy, height - 0.5F - grid.cy).normalized()};
  }

  [[nodiscard]] bool may_be_in_view(const Eigen::Vector3f& p_lidar) const {
    const Eigen::Vector3f p_camera = T_ * p_lidar;
    const float squared = p_camera.squaredNorm(), range = std::sqrt(squared);
    const bool near = range <= moved_;  // what may be shifted further than that can come from anywhere
    // The angle by which the point can turn in view, times the range: asin x <= x + (pi / 2 - 1) x^3, which are equal
    // at 0 and 1, and a margin for roundoff.
    const float shift = turn_ * range + moved_ * (1 + 0.571F * (moved_ * moved_ / squared)) + 1e-4F * range;
    if (wide_)
      return std::isfinite(range) &&
             (near || shift >= still_ * range || p_camera.z() >= range * std::cos(max_angle_ + shift / range));
    // sin x <= x, and nothing is further outside than its range. No branches: which points are kept has no pattern.
    bool inside = true;
    for (const Eigen::Vector3f& side : sides_) inside &= side.dot(p_camera) >= -shift;
    return std::isfinite(range) & (near | inside);
  }

 private:
  Eigen::Isometry3f T_;
  bool wide_;
  float max_angle_, turn_, moved_, still_;
  std::array<Eigen::Vector3f, 4> sides_;
};

}  // namespace calib
