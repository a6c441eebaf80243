#pragma once

#include <Eigen/Core>
#include <algorithm>

#include "calib/geometry.hpp"
#include "vehicle/mesh.hpp"

namespace calib::vehicle {

/// A triangle in a sensor's frame with the maps from a point on it to its texture: u = u_map . p + u0.
struct SurfacePlane {
  Eigen::Vector3f a, b, c;
  Eigen::Vector3f normal;  // not of unit length; towards the side that is seen
  Eigen::Vector3f u_map, v_map;
  float u0, v0;
  Surface surface;

  /// From the triangle's corners in the sensor's frame.
  SurfacePlane(const Triangle& triangle, const Eigen::Vector3f& a_, const Eigen::Vector3f& b_,
               const Eigen::Vector3f& c_)
      : a(a_), b(b_), c(c_), normal((b_ - a_).cross(c_ - a_)), surface(triangle.surface) {
    const auto& [A, B, C] = triangle.corners;
    // Along the dual basis of the two edges: the map's value on an edge is the texture's change along it.
    const float scale = 1 / std::max(normal.squaredNorm(), 1e-20f);
    const Eigen::Vector3f dual_b = (c - a).cross(normal) * scale, dual_c = normal.cross(b - a) * scale;
    u_map = (B.u - A.u) * dual_b + (C.u - A.u) * dual_c;
    v_map = (B.v - A.v) * dual_b + (C.v - A.v) * dual_c;
    u0 = A.u - u_map.dot(a);
    v0 = A.v - v_map.dot(a);
  }

  /// The sensor, at the origin, is on the side that is seen.
  [[nodiscard]] bool faces_origin() const { return normal.dot(a) < 0; }
};

}  // namespace calib::vehicle
