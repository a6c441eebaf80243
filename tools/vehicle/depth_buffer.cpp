#include "vehicle/depth_buffer.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace calib::vehicle {
namespace {

using Eigen::Vector2f;
using Eigen::Vector3f;

constexpr float near_m = 0.25f;

/// A linear function of the viewing ray ((x - cx) / fx, (y - cy) / fy, 1) as one of the pixel (x, y, 1).
Vector3f of_pixel(const Vector3f& of_ray, const Camera& camera) {
  const float gx = of_ray.x() / static_cast<float>(camera.fx()), gy = of_ray.y() / static_cast<float>(camera.fy());
  return {gx, gy, of_ray.z() - gx * static_cast<float>(camera.cx()) - gy * static_cast<float>(camera.cy())};
}

/// The part of a triangle in front of the camera: a polygon of 0, 3 or 4 corners.
int clip_near(const FacingTriangle& facing, std::array<Vector3f, 4>& polygon) {
  const std::array<const Vector3f*, 3> corner{&facing.a, &facing.b, &facing.c};
  int count = 0;
  for (int i = 0; i < 3; ++i) {
    const Vector3f &p = *corner[i], &q = *corner[(i + 1) % 3];
    if (p.z() >= near_m) polygon[count++] = p;
    if ((p.z() >= near_m) != (q.z() >= near_m)) polygon[count++] = p + (q - p) * ((near_m - p.z()) / (q.z() - p.z()));
  }
  return count;
}

}  // namespace

DepthBuffer::DepthBuffer(const Camera& camera)
    : camera_(camera), nearest_(camera.width() * camera.height(), 0.f), face_(nearest_.size(), no_face) {}

void DepthBuffer::draw(const Triangle& triangle, const FacingTriangle& facing, const Vector3f& sun,
                       const Light& light) {
  std::array<Vector3f, 4> polygon;
  const int count = clip_near(facing, polygon);
  if (count == 0) return;
  std::array<Vector2f, 4> corners;
  for (int i = 0; i < count; ++i) corners[i] = project(polygon[i]);
  // On the plane n . p = n . a, so 1/z = n . ray / (n . a), and u/z = u_map . ray + u0 / z.
  const Vector3f inverse_depth = of_pixel(facing.normal / facing.normal.dot(facing.a), camera_);
  if (!fill(corners, count, inverse_depth)) return;
  const TextureMap texture(triangle, facing);
  const float cosine = facing.normal.dot(sun) / facing.normal.norm();
  // The sky lights what looks away from the sun.
  const float sunlight = light.sunlight * std::max(cosine, 0.f), all = light.skylight + sunlight + 0.08f * cosine;
  faces_.push_back({inverse_depth, of_pixel(texture.u_map, camera_) + texture.u0 * inverse_depth,
                    of_pixel(texture.v_map, camera_) + texture.v0 * inverse_depth, all, sunlight, triangle.surface});
}

Vector2f DepthBuffer::project(const Vector3f& p) const {
  return {static_cast<float>(camera_.fx()) * p.x() / p.z() + static_cast<float>(camera_.cx()),
          static_cast<float>(camera_.fy()) * p.y() / p.z() + static_cast<float>(camera_.cy())};
}

bool DepthBuffer::fill(const std::array<Vector2f, 4>& corners, int count, const Vector3f& inverse_depth) {
  float top = corners[0].y(), bottom = top, left = corners[0].x(), right = left;
  for (int i = 1; i < count; ++i) {
    top = std::min(top, corners[i].y()), bottom = std::max(bottom, corners[i].y());
    left = std::min(left, corners[i].x()), right = std::max(right, corners[i].x());
  }
  const int width = camera_.width(), height = camera_.height();
  if (!(bottom >= 0 && top < static_cast<float>(height) && right >= 0 && left < static_cast<float>(width)))
    return false;
  const auto id = static_cast<std::uint32_t>(faces_.size());
  const int first = std::max(0, static_cast<int>(std::ceil(top)));
  const int last = std::min(height - 1, static_cast<int>(std::ceil(std::min(bottom, 1e6f))) - 1);
  bool any = false;
  for (int y = first; y <= last; ++y) {
    float from = std::numeric_limits<float>::max(), to = -from;
    for (int i = 0; i < count; ++i) {
      // From the upper to the lower corner, whichever triangle the edge belongs to: neighbours leave no
      // gap.
      const bool down = corners[i].y() < corners[(i + 1) % count].y();
      const Vector2f &p = corners[down ? i : (i + 1) % count], &q = corners[down ? (i + 1) % count : i];
      const float row = static_cast<float>(y);
      if (row < p.y() || row >= q.y()) continue;
      const float x = p.x() + (q.x() - p.x()) * ((row - p.y()) / (q.y() - p.y()));
      from = std::min(from, x), to = std::max(to, x);
    }
    if (!(from < static_cast<float>(width) && to > 0)) continue;
    const int begin = std::max(0, static_cast<int>(std::ceil(from)));
    const int end = std::min(width, static_cast<int>(std::ceil(std::min(to, 1e6f))));
    const float row_value = inverse_depth.y() * static_cast<float>(y) + inverse_depth.z();
    float* nearest = nearest_.data() + y * width;
    std::uint32_t* face = face_.data() + y * width;
    for (int x = begin; x < end; ++x) {
      const float value = inverse_depth.x() * static_cast<float>(x) + row_value;
      if (value > nearest[x]) nearest[x] = value, face[x] = id, any = true;
    }
  }
  return any;
}

}  // namespace calib::vehicle
