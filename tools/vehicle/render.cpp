#include "vehicle/render.hpp"

#include <array>
#include <cmath>
#include <limits>
#include <optional>

#include "vehicle/depth_buffer.hpp"

namespace calib::vehicle {
namespace {

using Eigen::Vector3f;

/// Bright near the horizon, darker above, with soft clouds; all at infinity.
float sky(const NoiseTexture& noise, const Light& light, const Vector3f& direction) {
  const float height = std::max(direction.z(), 0.f);
  const float u = direction.x() / (height + 0.15f), v = direction.y() / (height + 0.15f);
  return light.horizon - light.drop * std::min(height, 1.f) + light.clouds * noise.at(u, v, 0.03f, 0.03f);
}

float shade(const NoiseTexture& noise, const Light& light, const Face& face, bool in_shadow, float x, float y,
            float z) {
  const float u = (face.u_over_z.x() * x + face.u_over_z.y() * y + face.u_over_z.z()) * z;
  const float v = (face.v_over_z.x() * x + face.v_over_z.y() * y + face.v_over_z.z()) * z;
  // Change of the texture position from this pixel to the next across and down.
  const float du = std::abs(face.u_over_z.x() - u * face.inverse_depth.x()) +
                   std::abs(face.u_over_z.y() - u * face.inverse_depth.y());
  const float dv = std::abs(face.v_over_z.x() - v * face.inverse_depth.x()) +
                   std::abs(face.v_over_z.y() - v * face.inverse_depth.y());
  const float haze = 1 - std::exp(-z / light.haze_m);
  const float falling = in_shadow ? face.light - face.sunlight : face.light;
  const float surface = falling * albedo(noise, face.surface, u, v, du * z, dv * z);
  return surface + haze * (light.haze - surface);
}

/// Draws what faces the camera.
void draw(DepthBuffer& buffer, const std::vector<Instance>& instances, const RigidTransform& T_camera_world,
          const Light& light) {
  const Vector3f sun = (T_camera_world.linear() * light.sun).cast<float>();
  for (const Instance& instance : instances) {
    const Eigen::Isometry3f T_camera_mesh = (T_camera_world * instance.T_world_mesh).cast<float>();
    for (const Triangle& triangle : instance.mesh->triangles) {
      const FacingTriangle facing(triangle, T_camera_mesh);
      if (facing.faces_origin()) buffer.draw(triangle, facing, sun, light);
    }
  }
}

/// What the sun sees of the surroundings of a camera, and with it what lies in shadow. The sun's rays are made all but
/// parallel by looking from far away.
class SunView {
 public:
  SunView(const std::vector<Instance>& instances, const Light& light, const RigidTransform& T_world_camera)
      : camera_(Camera::make(CameraModel::rectified, size, size,
                             {size * distance_m / across_m, size * distance_m / across_m, 0.5 * size, 0.5 * size})
                    .value()),
        buffer_(camera_) {
    // Most of what the camera sees well is within `across_m` of the place ahead of it that this looks at.
    const Eigen::Vector3d target = T_world_camera * Eigen::Vector3d(0, 0, 0.35 * across_m);
    RigidTransform T_world_sun = RigidTransform::Identity();
    T_world_sun.linear() = Eigen::Quaterniond::FromTwoVectors(Eigen::Vector3d::UnitZ(), -light.sun).toRotationMatrix();
    T_world_sun.translation() = target + distance_m * light.sun;
    draw(buffer_, instances, T_world_sun.inverse(), light);
    T_sun_camera_ = (T_world_sun.inverse() * T_world_camera).cast<float>();
  }

  /// Something is between the sun and `p` (camera's frame).
  [[nodiscard]] bool hides(const Vector3f& p) const {
    const Vector3f seen = T_sun_camera_ * p;
    const float scale = static_cast<float>(camera_.fx()) / seen.z(), centre = 0.5f * size;
    const int x = static_cast<int>(std::lround(scale * seen.x() + centre)),
              y = static_cast<int>(std::lround(scale * seen.y() + centre));
    if (x < 0 || x >= size || y < 0 || y >= size) return false;
    return buffer_.inverse_depth_at(y * size + x) * (seen.z() - tolerance_m) > 1;
  }

 private:
  static constexpr int size = 1536;
  static constexpr double distance_m = 600, across_m = 110;
  static constexpr float tolerance_m = 0.15f;
  const Camera camera_;
  DepthBuffer buffer_;
  Eigen::Isometry3f T_sun_camera_;
};

/// The scene as a rectified camera sees it, to be asked at any place of the image.
class View {
 public:
  View(const NoiseTexture& noise, const Light& light, const std::vector<Instance>& instances, const Camera& camera,
       const RigidTransform& T_world_camera)
      : noise_(noise),
        light_(light),
        camera_(camera),
        R_world_camera_(T_world_camera.linear().cast<float>()),
        buffer_(camera) {
    draw(buffer_, instances, T_world_camera.inverse(), light);
    if (light.cast_shadows) sun_view_.emplace(instances, light, T_world_camera);
  }

  struct Sample {
    float brightness, depth_m;  // depth along the optical axis, infinite in the sky
  };
  /// On the surface that the nearest pixel shows.
  [[nodiscard]] Sample at(float x, float y) const {
    const float column = std::clamp(std::round(x), 0.f, static_cast<float>(camera_.width() - 1)),
                row = std::clamp(std::round(y), 0.f, static_cast<float>(camera_.height() - 1));
    const Face* face = buffer_.face_at(static_cast<int>(row) * camera_.width() + static_cast<int>(column));
    if (!face)
      return {sky(noise_, light_, R_world_camera_ * ray(x, y).normalized()), std::numeric_limits<float>::infinity()};
    // A surface seen edge-on may end between the pixel's centre and (x, y), and 1/z with it.
    const Vector3f& inverse = face->inverse_depth;
    const float nearby = inverse.x() * column + inverse.y() * row + inverse.z();
    const float z = 1 / std::max(inverse.x() * x + inverse.y() * y + inverse.z(), 0.5f * nearby);
    const bool in_shadow = sun_view_ && face->sunlight > 0 && sun_view_->hides(z * ray(x, y));
    return {shade(noise_, light_, *face, in_shadow, x, y, z), z};
  }

 private:
  [[nodiscard]] Vector3f ray(float x, float y) const {
    return {(x - static_cast<float>(camera_.cx())) / static_cast<float>(camera_.fx()),
            (y - static_cast<float>(camera_.cy())) / static_cast<float>(camera_.fy()), 1};
  }

  const NoiseTexture& noise_;
  const Light& light_;
  const Camera& camera_;
  Eigen::Matrix3f R_world_camera_;
  DepthBuffer buffer_;
  std::optional<SunView> sun_view_;
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

Rendering render(const NoiseTexture& noise, const Light& light, const std::vector<Instance>& instances,
                 const Camera& camera, const RigidTransform& T_world_camera) {
  const View view(noise, light, instances, camera, T_world_camera);
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

Rendering render(const Scene& scene, const std::vector<Instance>& instances, const Camera& camera,
                 const RigidTransform& T_world_camera) {
  return render(scene.noise(), scene.light(), instances, camera, T_world_camera);
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
        view.emplace(scene.noise(), scene.light(), instances, camera, T_world_face);
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
