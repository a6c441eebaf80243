#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "calib/camera.hpp"
#include "vehicle/facing_triangle.hpp"
#include "vehicle/light.hpp"

namespace calib::vehicle {

/// A triangle as the camera sees it. Over the image, 1/z, u/z and v/z are linear: value = gradient . (x, y, 1).
struct Face {
  Eigen::Vector3f inverse_depth, u_over_z, v_over_z;
  float light, sunlight;  // all that falls on it; the sun's share of that
  Surface surface;
};

/// Faces in front of a rectified camera, and for every pixel which of them is nearest.
class DepthBuffer {
 public:
  /// `camera` must outlive it.
  explicit DepthBuffer(const Camera& camera);

  /// `sun`: unit vector, camera's frame.
  void draw(const Triangle& triangle, const FacingTriangle& facing, const Eigen::Vector3f& sun, const Light& light);

  [[nodiscard]] const Face* face_at(int index) const {
    return face_[index] == no_face ? nullptr : &faces_[face_[index]];
  }
  /// 1/z of a pixel, 0 where nothing was drawn.
  [[nodiscard]] float inverse_depth_at(int index) const { return nearest_[index]; }

 private:
  static constexpr std::uint32_t no_face = 0xffffffffU;

  [[nodiscard]] Eigen::Vector2f project(const Eigen::Vector3f& p) const;
  /// Marks the pixels inside the polygon where it is the nearest so far; whether there were any.
  bool fill(const std::array<Eigen::Vector2f, 4>& corners, int count, const Eigen::Vector3f& inverse_depth);

  const Camera& camera_;
  std::vector<Face> faces_;
  std::vector<float> nearest_;  // 1/z
  std::vector<std::uint32_t> face_;
};

}  // namespace calib::vehicle
