#include "vehicle/render.hpp"

#include <array>
#include <cmath>
#include <limits>

#include "vehicle/facing_triangle.hpp"

namespace calib::vehicle {
namespace {

using Eigen::Vector2f;
using Eigen::Vector3f;

constexpr float near_m = 0.25f;

/// A triangle as the camera sees it. Over the image, 1/z, u/z and v/z are linear: value = gradient . (x, y,
/// 1).
struct Face {
  Vector3f inverse_depth, u_over_z, v_over_z;
  float light;
  Surface surface;
};

/// A linear function of the viewing ray ((x - cx) / fx, (y - cy) / fy, 1) as one of the pixel (x, y, 1).
Vector3f of_pixel(const Vector3f& of_ray, const Camera& camera) {
  const float gx = of_ray.x() / static_cast<float>(camera.fx()),
              gy = of_ray.y() / static_cast<float>(camera.fy());
  return {gx, gy, of_ray.z() - gx * static_cast<float>(camera.cx()) - gy * static_cast<float>(camera.cy())};
}

/// The part of a triangle in front of the camera: a polygon of 0, 3 or 4 corners.
int clip_near(const FacingTriangle& facing, std::array<Vector3f, 4>& polygon) {
  const std::array<const Vector3f*, 3> corner{&facing.a, &facing.b, &facing.c};
  int count = 0;
  for (int i = 0; i < 3; ++i) {
    const Vector3f &p = *corner[i], &q = *corner[(i + 1) % 3];
    if (p.z() >= near_m) polygon[count++] = p;
    if ((p.z() >= near_m) != (q.z() >= near_m))
      polygon[count++] = p + (q - p) * ((near_m - p.z()) / (q.z() - p.z()));
  }
  return count;
}

/// Faces in front of the camera, and for every pixel which of them is nearest.
class DepthBuffer {
 public:
  explicit DepthBuffer(const Camera& camera)
      : camera_(camera), nearest_(camera.width() * camera.height(), 0.f), face_(nearest_.size(), no_face) {}

  /// `sun`: unit vector, camera's frame.
  void draw(const Triangle& triangle, const FacingTriangle& facing, const Vector3f& sun) {
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
    const float light = 0.55f + 0.55f * std::max(cosine, 0.f) + 0.08f * cosine;
    faces_.push_back({inverse_depth, of_pixel(texture.u_map, camera_) + texture.u0 * inverse_depth,
                      of_pixel(texture.v_map, camera_) + texture.v0 * inverse_depth, light,
                      triangle.surface});
  }

  [[nodiscard]] const Face* face_at(int index) const {
    return face_[index] == no_face ? nullptr : &faces_[face_[index]];
  }

 private:
  static constexpr std::uint32_t no_face = 0xffffffffU;

  [[nodiscard]] Vector2f project(const Vector3f& p) const {
    return {static_cast<float>(camera_.fx()) * p.x() / p.z() + static_cast<float>(camera_.cx()),
            static_cast<float>(camera_.fy()) * p.y() / p.z() + static_cast<float>(camera_.cy())};
  }

  /// Marks the pixels inside the polygon where it is the nearest so far; whether there were any.
  bool fill(const std::array<Vector2f, 4>& corners, int count, const Vector3f& inverse_depth) {
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

  const Camera& camera_;
  std::vector<Face> faces_;
  std::vector<float> nearest_;  // 1/z
  std::vector<std::uint32_t> face_;
};

/// Bright near the horizon, darker above, with soft clouds; all at infinity.
float sky(const NoiseTexture& noise, const Vector3f& direction) {
  const float height = std::max(direction.z(), 0.f);
  const float u = direction.x() / (height + 0.15f), v = direction.y() / (height + 0.15f);
  return 0.95f - 0.35f * std::min(height, 1.f) + 0.05f * noise.at(u, v, 0.03f, 0.03f);
}

float shade(const NoiseTexture& noise, const Face& face, float x, float y, float& depth_m) {
  const float w = face.inverse_depth.x() * x + face.inverse_depth.y() * y + face.inverse_depth.z();
  const float z = 1 / w;
  depth_m = z;
  const float u = (face.u_over_z.x() * x + face.u_over_z.y() * y + face.u_over_z.z()) * z;
  const float v = (face.v_over_z.x() * x + face.v_over_z.y() * y + face.v_over_z.z()) * z;
  // Change of the texture position from this pixel to the next across and down.
  const float du = std::abs(face.u_over_z.x() - u * face.inverse_depth.x()) +
                   std::abs(face.u_over_z.y() - u * face.inverse_depth.y());
  const float dv = std::abs(face.v_over_z.x() - v * face.inverse_depth.x()) +
                   std::abs(face.v_over_z.y() - v * face.inverse_depth.y());
  const float haze = 1 - std::exp(-z / 400);
  const float surface = face.light * albedo(noise, face.surface, u, v, du * z, dv * z);
  return surface + haze * (0.8f - surface);
}

}  // namespace

Rendering render(const Scene& scene, const std::vector<Instance>& instances, const Camera& camera,
                 const RigidTransform& T_world_camera) {
  DepthBuffer buffer(camera);
  const RigidTransform T_camera_world = T_world_camera.inverse();
  for (const Instance& instance : instances) {
    const Eigen::Isometry3f T_camera_mesh = (T_camera_world * instance.T_world_mesh).cast<float>();
    const Vector3f sun = (T_camera_world.linear() * scene.sun()).cast<float>();
    for (const Triangle& triangle : instance.mesh->triangles) {
      const FacingTriangle facing(triangle, T_camera_mesh);
      if (facing.faces_origin()) buffer.draw(triangle, facing, sun);
    }
  }

  Rendering result{camera.width(), camera.height(), {}, {}};
  result.brightness.resize(camera.width() * camera.height());
  result.depth_m.assign(result.brightness.size(), std::numeric_limits<float>::infinity());
  const Eigen::Matrix3f R_world_camera = T_world_camera.linear().cast<float>();
  for (int y = 0; y < camera.height(); ++y)
    for (int x = 0; x < camera.width(); ++x) {
      const int index = y * camera.width() + x;
      if (const Face* face = buffer.face_at(index)) {
        result.brightness[index] =
            shade(scene.noise(), *face, static_cast<float>(x), static_cast<float>(y), result.depth_m[index]);
      } else {
        const Vector3f ray(
            (static_cast<float>(x) - static_cast<float>(camera.cx())) / static_cast<float>(camera.fx()),
            (static_cast<float>(y) - static_cast<float>(camera.cy())) / static_cast<float>(camera.fy()), 1);
        result.brightness[index] = sky(scene.noise(), R_world_camera * ray.normalized());
      }
    }
  return result;
}

Image expose(const Rendering& rendering, float exposure, std::uint64_t key) {
  const int width = rendering.width, height = rendering.height;
  const auto blurred = [&](int x, int y) {
    const auto row = [&](int line) {
      const float* p = rendering.brightness.data() + line * width;
      return 0.7f * p[x] + 0.15f * (p[std::max(x - 1, 0)] + p[std::min(x + 1, width - 1)]);
    };
    return 0.7f * row(y) + 0.15f * (row(std::max(y - 1, 0)) + row(std::min(y + 1, height - 1)));
  };
  Image image{{}, width, height, {}};
  image.pixels.resize(width * height);
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) {
      // Sum of four uniform bytes: near enough to a normal distribution (standard deviation 148), and cheap.
      const std::uint64_t bits = mix(key + static_cast<std::uint64_t>(y) * width + x);
      const int sum =
          static_cast<int>((bits & 255) + (bits >> 8 & 255) + (bits >> 16 & 255) + (bits >> 24 & 255)) - 510;
      const float value =
          235 * std::sqrt(std::max(0.f, exposure * blurred(x, y))) + static_cast<float>(sum) * (1.3f / 148);
      image.pixels[y * width + x] = static_cast<std::uint8_t>(std::clamp(value + 0.5f, 0.f, 255.f));
    }
  return image;
}

}  // namespace calib::vehicle
