#pragma once

#include <Eigen/Core>
#include <algorithm>

#include "calib/geometry.hpp"
#include "vehicle/mesh.hpp"

namespace calib::vehicle {

/// A triangle in a sensor's frame.
struct FacingTriangle {
  Eigen::Vector3f a, b, c;
  Eigen::Vector3f normal;  // not of unit length; towards the side that is seen

  FacingTriangle(const Triangle& triangle, const Eigen::Isometry3f& T_sensor_mesh)
      : a(T_sensor_mesh * triangle.corners[0].p),
        b(T_sensor_mesh * triangle.corners[1].p),
        c(T_sensor_mesh * triangle.corners[2].p),
        normal((b - a).cross(c - a)) {}

  /// The sensor, at the origin, is on the side that is seen.
  [[nodiscard]] bool faces_origin() const { return normal.dot(a) < 0; }
};

/// From a point of a triangle (sensor's frame) to its place on the texture: u = u_map . p + u0, v likewise.
struct TextureMap {
  Eigen::Vector3f u_map, v_map;
  float u0, v0;

  TextureMap(const Triangle& triangle, const FacingTriangle& facing) {
    const auto& [a, b, c] = triangle.corners;
    const Eigen::Vector3f& normal = facing.normal;
    // Along the dual basis of the two edges: the map's value on an edge is the texture's change along it.
    const float scale = 1 / std::max(normal.squaredNorm(), 1e-20f);
    const Eigen::Vector3f dual_b = (facing.c - facing.a).cross(normal) * scale;
    const Eigen::Vector3f dual_c = normal.cross(facing.b - facing.a) * scale;
    u_map = (b.u - a.u) * dual_b + (c.u - a.u) * dual_c;
    v_map = (b.v - a.v) * dual_b + (c.v - a.v) * dual_c;
    u0 = a.u - u_map.dot(facing.a);
    v0 = a.v - v_map.dot(facing.a);
  }
  [[nodiscard]] float u(const Eigen::Vector3f& p) const { return u_map.dot(p) + u0; }
  [[nodiscard]] float v(const Eigen::Vector3f& p) const { return v_map.dot(p) + v0; }
};

}  // namespace calib::vehicle
