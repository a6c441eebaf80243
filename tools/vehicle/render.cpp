#include "vehicle/render.hpp"

#include <array>
#include <cmath>
#include <limits>
#include <optional>

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
                      of_pixel(texture.v_map, camera_) + texture.v0 * inverse_depth, light, triangle.surface});
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

float shade(const NoiseTexture& noise, const Face& face, float x, float y, float z) {
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

/// The scene as a rectified camera sees it, to be asked at any place of the image.
class View {
 public:
  View(const Scene& scene, const std::vector<Instance>& instances, const Camera& camera,
       const RigidTransform& T_world_camera)
      : noise_(scene.noise()),
        camera_(camera),
        R_world_camera_(T_world_camera.linear().cast<float>()),
        buffer_(camera) {
    const RigidTransform T_camera_world = T_world_camera.inverse();
    const Vector3f sun = (T_camera_world.linear() * scene.sun()).cast<float>();
    for (const Instance& instance : instances) {
      const Eigen::Isometry3f T_camera_mesh = (T_camera_world * instance.T_world_mesh).cast<float>();
      for (const Triangle& triangle : instance.mesh->triangles) {
        const FacingTriangle facing(triangle, T_camera_mesh);
        if (facing.faces_origin()) buffer_.draw(triangle, facing, sun);
      }
    }
  }

  struct Sample {
    float brightness, depth_m;  // depth along the optical axis, infinite in the sky
  };
  /// On the surface that the nearest pixel shows.
  [[nodiscard]] Sample at(float x, float y) const {
    const float column = std::clamp(std::round(x), 0.f, static_cast<float>(camera_.width() - 1)),
                row = std::clamp(std::round(y), 0.f, static_cast<float>(camera_.height() - 1));
    const Face* face = buffer_.face_at(static_cast<int>(row) * camera_.width() + static_cast<int>(column));
    if (!face) return {sky(noise_, R_world_camera_ * ray(x, y).normalized()), std::numeric_limits<float>::infinity()};
    // A surface seen edge-on may end between the pixel's centre and (x, y), and 1/z with it.
    const Vector3f& inverse = face->inverse_depth;
    const float nearby = inverse.x() * column + inverse.y() * row + inverse.z();
    const float z = 1 / std::max(inverse.x() * x + inverse.y() * y + inverse.z(), 0.5f * nearby);
    return {shade(noise_, *face, x, y, z), z};
  }

 private:
  [[nodiscard]] Vector3f ray(float x, float y) const {
    return {(x - static_cast<float>(camera_.cx())) / static_cast<float>(camera_.fx()),
            (y - static_cast<float>(camera_.cy())) / static_cast<float>(camera_.fy()), 1};
  }

  const NoiseTexture& noise_;
  const Camera& camera_;
  Eigen::Matrix3f R_world_camera_;
  DepthBuffer buffer_;
};

Rendering empty_rendering(int width, int height) {
  const std::size_t pixels = static_cast<std::size_t>(width) * height;
  return {width, height, std::vector<float>(pixels, 0.f),
          std::vector<float>(pixels, std::numeric_limits<float>::infinity())};
}

/// A camera's frame to that of its cube's faces: each looks along an axis, either way.
Eigen::Matrix3f face_axes(int face) {
  Eigen::Matrix3f R_camera_face;
  const float sign = face % 2 == 0 ? 1.f : -1.f;
  switch (face / 2) {
    case 0:  // ahead, back
      R_camera_face << sign, 0, 0, 0, 1, 0, 0, 0, sign;
      break;
    case 1:  // right, left
      R_camera_face << 0, 0, sign, 0, 1, 0, -sign, 0, 0;
      break;
    default:  // down, up
      R_camera_face << 1, 0, 0, 0, 0, sign, 0, -sign, 0;
  }
  return R_camera_face;
}

/// The face that `ray` goes through.
int face_of(const Vector3f& ray) {
  int axis = 0;
  ray.cwiseAbs().maxCoeff(&axis);
  constexpr std::array<int, 3> first{2, 4, 0};
  return first[axis] + (ray[axis] < 0 ? 1 : 0);
}

}  // namespace

Rendering render(const Scene& scene, const std::vector<Instance>& instances, const Camera& camera,
                 const RigidTransform& T_world_camera) {
  const View view(scene, instances, camera, T_world_camera);
  Rendering result = empty_rendering(camera.width(), camera.height());
  for (int y = 0; y < camera.height(); ++y)
    for (int x = 0; x < camera.width(); ++x) {
      const int index = y * camera.width() + x;
      const auto sample = view.at(static_cast<float>(x), static_cast<float>(y));
      result.brightness[index] = sample.brightness;
      result.depth_m[index] = sample.depth_m;
    }
  return result;
}

WideRenderer::WideRenderer(const Camera& camera) : width_(camera.width()), height_(camera.height()) {
  rays_.reserve(static_cast<std::size_t>(width_) * height_);
  for (int y = 0; y < height_; ++y)
    for (int x = 0; x < width_; ++x)
      rays_.push_back(camera.unproject(Eigen::Vector2d(x, y)).value_or(Eigen::Vector3d::Zero()).cast<float>());

  float smallest_step = 1;
  across_pixel_.assign(rays_.size(), {Vector3f::Zero(), Vector3f::Zero()});
  for (int y = 0; y < height_; ++y)
    for (int x = 0; x < width_; ++x) {
      const int index = y * width_ + x;
      const auto change = [&](int other) -> Vector3f {
        if (rays_[index].isZero() || rays_[other].isZero()) return Vector3f::Zero();
        smallest_step = std::min(smallest_step, (rays_[other] - rays_[index]).norm());
        return rays_[other] - rays_[index];
      };
      if (x + 1 < width_) across_pixel_[index][0] = change(index + 1);
      if (y + 1 < height_) across_pixel_[index][1] = change(index + width_);
    }
  // Twice as fine as the image where it is finest: a cube of edge 2 at distance 1 has size / 2 pixels a radian.
  face_size_ = std::clamp(static_cast<int>(4 / smallest_step), 64, 4096);
}

Rendering WideRenderer::render(const Scene& scene, const std::vector<Instance>& instances,
                               const RigidTransform& T_world_camera) const {
  Rendering result = empty_rendering(width_, height_);
  const double half = 0.5 * face_size_;
  const Camera camera =
      Camera::make(CameraModel::rectified, face_size_, face_size_, {half, half, half - 0.5, half - 0.5}).value();
  for (int face = 0; face < 6; ++face) {
    const Eigen::Matrix3f R_camera_face = face_axes(face);
    std::optional<View> view;  // not drawn where the lens does not look
    const auto sample = [&](const Vector3f& ray) {
      if (!view) {
        RigidTransform T_world_face = T_world_camera;
        T_world_face.linear() = T_world_camera.linear() * R_camera_face.cast<double>();
        view.emplace(scene, instances, camera, T_world_face);
      }
      const Vector3f p = R_camera_face.transpose() * ray;
      const float size = static_cast<float>(half);
      return view->at(size * p.x() / p.z() + size - 0.5f, size * p.y() / p.z() + size - 0.5f);
    };
    for (std::size_t i = 0; i < rays_.size(); ++i) {
      const Vector3f& centre = rays_[i];
      if (centre.isZero()) continue;
      if (face_of(centre) == face) {
        const float along_axis = centre.dot(R_camera_face.col(2));
        result.depth_m[i] = sample(centre).depth_m / along_axis;
      }
      for (const auto& [right, down] : {std::pair{-0.25f, -0.25f}, {0.25f, -0.25f}, {-0.25f, 0.25f}, {0.25f, 0.25f}}) {
        const Vector3f ray = centre + right * across_pixel_[i][0] + down * across_pixel_[i][1];
        if (face_of(ray) == face) result.brightness[i] += 0.25f * sample(ray).brightness;
      }
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
