#include "calib/camera.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>

#include "calib/geometry.hpp"
#include "camera_models.hpp"

namespace calib {
namespace {

struct ModelFacts {
  CameraModel model;
  std::string_view name, parameters;
  std::size_t least, most;  // numbers of distortion
};

constexpr std::array<ModelFacts, 7> models{{
    {CameraModel::rectified, "rectified", "", 0, 0},
    {CameraModel::plumb_bob, "plumb_bob", "k1, k2, p1, p2 and, optionally, k3", 4, 5},
    {CameraModel::rational_polynomial, "rational_polynomial", "k1, k2, p1, p2, k3, k4, k5, k6", 8, 8},
    {CameraModel::equidistant, "equidistant", "k1, k2, k3, k4", 4, 4},
    {CameraModel::double_sphere, "double_sphere", "xi, alpha", 2, 2},
    {CameraModel::eucm, "eucm", "alpha, beta", 2, 2},
    {CameraModel::mei, "mei", "xi, k1, k2, p1, p2", 5, 5},
}};

const ModelFacts& facts(CameraModel model) { return *std::ranges::find(models, model, &ModelFacts::model); }

/// `project` ends this much before the model's fold, where the inverse, which has an infinite slope there, still is
/// good to 1e-9.
constexpr double fold_margin_rad = 1e-6;

Result<void> check_image(int width, int height, const std::vector<double>& intrinsics) {
  if (width < 16 || height < 16 || static_cast<std::int64_t>(width) * height > 64'000'000)
    return fail(ErrorCode::bad_camera, "image size " + std::to_string(width) + " x " + std::to_string(height) +
                                           " is outside 16 x 16 .. 64 Mpx");
  if (intrinsics.size() != 4)
    return fail(ErrorCode::bad_camera, "intrinsics are four numbers: fx, fy, cx, cy (pixels)");
  if (!std::ranges::all_of(intrinsics, [](double value) { return std::isfinite(value); }))
    return fail(ErrorCode::bad_camera, "intrinsics hold a number that is not finite");
  for (int i = 0; i < 2; ++i)
    if (intrinsics[i] <= 1 || intrinsics[i] >= 1e5)
      return fail(ErrorCode::bad_camera,
                  "focal length " + std::to_string(intrinsics[i]) + " is outside 1 .. 1e5 pixels");
  return {};
}

Result<void> check_distortion(CameraModel model, const std::vector<double>& d) {
  const ModelFacts& known = facts(model);
  const std::string name = "model " + std::string(known.name);
  if (model == CameraModel::rectified && !d.empty())
    return fail(ErrorCode::bad_camera, name + " has no distortion; write the model of the raw image's lens");
  if (d.size() < known.least || d.size() > known.most)
    return fail(ErrorCode::bad_camera, name + " needs distortion " + std::string(known.parameters));
  if (!std::ranges::all_of(d, [](double value) { return std::isfinite(value); }))
    return fail(ErrorCode::bad_camera, "distortion holds a number that is not finite");
  const auto outside = [&](std::string_view parameter, double value, std::string_view range) {
    return fail(ErrorCode::bad_camera, name + " has " + std::string(parameter) + " = " + std::to_string(value) +
                                           ", outside " + std::string(range) + "; its parameters are, in order, " +
                                           std::string(known.parameters));
  };
  const bool sphere = model == CameraModel::double_sphere, extended = model == CameraModel::eucm;
  if (sphere && !(d[0] > -1 && d[0] <= 1)) return outside("xi", d[0], "-1 < xi <= 1");
  if (sphere && !(d[1] >= 0 && d[1] <= 1)) return outside("alpha", d[1], "0 <= alpha <= 1");
  if (extended && !(d[0] >= 0 && d[0] <= 1)) return outside("alpha", d[0], "0 <= alpha <= 1");
  if (extended && !(d[1] > 0)) return outside("beta", d[1], "beta > 0");
  if (model == CameraModel::mei && !(d[0] >= 0 && d[0] <= 100)) return outside("xi", d[0], "0 <= xi <= 100");
  return {};
}

}  // namespace

Result<Camera> Camera::make(CameraModel model, int width, int height, const std::vector<double>& intrinsics,
                            const std::vector<double>& distortion) {
  if (const auto image = check_image(width, height, intrinsics); !image) return propagate(image);
  if (const auto lens = check_distortion(model, distortion); !lens) return propagate(lens);
  Camera camera;
  camera.model_ = model;
  camera.width_ = width;
  camera.height_ = height;
  camera.fx_ = intrinsics[0];
  camera.fy_ = intrinsics[1];
  camera.cx_ = intrinsics[2];
  camera.cy_ = intrinsics[3];
  camera.distortion_ = distortion;
  camera.distortion_.resize(facts(model).most, 0.0);
  camera.fold_rad_ = lens::fold_angle_rad(model, camera.distortion_);
  camera.min_cosine_ = std::cos(std::max(0.0, camera.fold_rad_ - fold_margin_rad));
  camera.max_angle_rad_ = camera.widest_angle_rad();
  return camera;
}

std::optional<Eigen::Vector2d> Camera::project(const Eigen::Vector3d& p_camera) const {
  const double range = p_camera.norm();
  if (!(range > 0 && std::isfinite(range) && p_camera.z() > min_cosine_ * range)) return std::nullopt;  // also NaN
  const Eigen::Vector2d m = lens::to_plane(model_, distortion_, p_camera, range);
  const Eigen::Vector2d uv(fx_ * m.x() + cx_, fy_ * m.y() + cy_);
  const bool inside = uv.x() >= -0.5 && uv.x() < width_ - 0.5 && uv.y() >= -0.5 && uv.y() < height_ - 0.5;
  if (!inside) return std::nullopt;
  return uv;
}

std::optional<Eigen::Vector3d> Camera::unproject(const Eigen::Vector2d& uv) const {
  const Eigen::Vector2d m((uv.x() - cx_) / fx_, (uv.y() - cy_) / fy_);
  if (!m.allFinite()) return std::nullopt;
  const auto bearing = lens::from_plane(model_, distortion_, m, fold_rad_);
  // Half the margin: what `project` gives must have its way back whatever the last digit.
  const double end_rad = std::max(0.0, fold_rad_ - 0.5 * fold_margin_rad);
  if (!bearing || !(bearing->z() > std::cos(end_rad))) return std::nullopt;
  return bearing;
}

/// The angle off the axis has no maximum inside the image: the widest is on the image's border, or on the model's where
/// that runs through the image, as it does when a pixel of the border has no bearing.
double Camera::widest_angle_rad() const {
  constexpr int steps = 128;
  constexpr double between_samples_rad = 0.1 * radians_per_degree;
  double least_cosine = 1;
  for (int i = 0; i <= steps; ++i) {
    const double u = -0.5 + width_ * (static_cast<double>(i) / steps);
    const double v = -0.5 + height_ * (static_cast<double>(i) / steps);
    for (const Eigen::Vector2d& uv : {Eigen::Vector2d(u, -0.5), Eigen::Vector2d(u, height_ - 0.5),
                                      Eigen::Vector2d(-0.5, v), Eigen::Vector2d(width_ - 0.5, v)}) {
      const auto bearing = unproject(uv);
      if (!bearing) return fold_rad_;
      least_cosine = std::min(least_cosine, bearing->z());
    }
  }
  return std::min(std::acos(least_cosine) + between_samples_rad, fold_rad_);
}

Result<Camera> Camera::resized(int width, int height) const {
  const double x = static_cast<double>(width) / width_, y = static_cast<double>(height) / height_;
  return make(model_, width, height, {fx_ * x, fy_ * y, (cx_ + 0.5) * x - 0.5, (cy_ + 0.5) * y - 0.5}, distortion_);
}

Result<CameraModel> parse_camera_model(std::string_view name) {
  const auto known = std::ranges::find(models, name, &ModelFacts::name);
  if (known != models.end()) return known->model;
  std::string names;
  for (const ModelFacts& model : models) names += (names.empty() ? "" : ", ") + std::string(model.name);
  return fail(ErrorCode::bad_camera, "camera model '" + escape_control(name) + "' is not known; use one of " + names);
}

std::string_view to_string(CameraModel model) { return facts(model).name; }

}  // namespace calib
