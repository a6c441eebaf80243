#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>
#include <cstdint>
#include <vector>

#include "vehicle/random.hpp"

namespace calib::vehicle {

enum class Material : std::uint8_t {
  road,
  asphalt,
  paving,
  kerb,
  earth,
  facade,
  roof,
  plain,
  metal,
  paint,
  glass,
  rubber,
  bark,
  leaves,
  sign,
  cloth,
  shadow,
  ground,   // any road, field or verge
  foliage,  // any greenery
  pattern,  // stripes, checks or blotches: brightness that is independent of the shape
  marking,
};

/// What a triangle is made of; `seed` picks its colour and pattern.
struct Surface {
  Material material = Material::plain;
  std::uint32_t seed = 0;
};

/// A corner in the mesh's frame (metres) and where it lies on the surface's texture (metres).
struct Corner {
  Eigen::Vector3f p;
  float u = 0, v = 0;
};

/// Seen from its front only: the side from which the corners run counter-clockwise.
struct Triangle {
  std::array<Corner, 3> corners;
  Surface surface;
};

/// A rigid thing of the street. x, y, z of its frame as the vehicle's: forward, left, up.
struct Mesh {
  std::vector<Triangle> triangles;

  /// Corners counter-clockwise from the front; texture u along a-b, v along a-d, (u0, v0) at a.
  void add_quad(const Eigen::Vector3f& a, const Eigen::Vector3f& b, const Eigen::Vector3f& c, const Eigen::Vector3f& d,
                Surface surface, float u0 = 0, float v0 = 0);
  /// As above with the texture position of every corner given.
  void add_quad(const std::array<Corner, 4>& corners, Surface surface);
  void add_triangle(const Corner& a, const Corner& b, const Corner& c, Surface surface);

  /// The box [low, high] of the frame `pose`.
  void add_box(const Eigen::Isometry3f& pose, const Eigen::Vector3f& low, const Eigen::Vector3f& high, Surface surface);
  /// A box whose top rectangle [top_low, top_high] (x, y) differs from its bottom one: cabins, hipped roofs.
  void add_frustum(const Eigen::Isometry3f& pose, const Eigen::Vector3f& low, const Eigen::Vector3f& high,
                   const Eigen::Vector2f& top_low, const Eigen::Vector2f& top_high, Surface surface);
  /// An upright tube from the origin of `pose` with a lid.
  void add_tube(const Eigen::Isometry3f& pose, float bottom_radius, float top_radius, float height, int sides,
                Surface surface);
  /// A closed, rough, round body of 80 triangles: crowns of trees, bushes, heads.
  void add_blob(const Eigen::Vector3f& centre, const Eigen::Vector3f& radii, float roughness, std::uint64_t seed,
                Surface surface);
};

}  // namespace calib::vehicle
