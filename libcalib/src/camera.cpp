#include "calib/camera.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "calib/geometry.hpp"

namespace calib {
namespace {

/// The names of the parameters, in order.
std::string names(std::span<const camera_models::Parameter> parameters) {
  std::string text;
  for (const camera_models::Parameter& parameter : parameters)
    text += (text.empty() ? "" : parameter.optional ? " and, optionally, " : ", ") + std::string(parameter.name);
  return text;
}

/// `project` ends this much before the end of the model's cone, where the inverse, which has an infinite slope there,
/// still is good to 1e-9.
constexpr double cone_margin_rad = 1e-6;

Result<void> check_image(int width, int height, const std::vector<double>& intrinsics) {
  if (width < 16 || height < 16 || static_cast<std::int64_t>(width) * height > 64'000'000)
    return fail(ErrorCode::bad_camera, fmt::format("image size {} x {} is outside 16 x 16 .. 64 Mpx", width, height));
  if (intrinsics.size() != 4)
    return fail(ErrorCode::bad_camera, "intrinsics are four numbers: fx, fy, cx, cy (pixels)");
  if (!std::ranges::all_of(intrinsics, [](double value) { return std::isfinite(value); }))
    return fail(ErrorCode::bad_camera, "intrinsics hold a number that is not finite");
  for (int i = 0; i < 2; ++i)
    if (intrinsics[i] <= 1 || intrinsics[i] >= 1e5)
      return fail(ErrorCode::bad_camera, fmt::format("focal length {:f} is outside 1 .. 1e5 pixels", intrinsics[i]));
  return {};
}

Result<void> check_distortion(const CameraModelFacts& model, const std::vector<double>& d) {
  const auto needed =
      static_cast<std::size_t>(std::ranges::count(model.parameters, false, &camera_models::Parameter::optional));
  const std::string name = "model " + std::string(model.name);
  if (model.parameters.empty() && !d.empty())
    return fail(ErrorCode::bad_camera, name + " has no distortion; write the model of the raw image's lens");
  if (d.size() < needed || d.size() > model.parameters.size())
    return fail(ErrorCode::bad_camera, name + " needs distortion " + names(model.parameters));
  if (!std::ranges::all_of(d, [](double value) { return std::isfinite(value); }))
    return fail(ErrorCode::bad_camera, "distortion holds a number that is not finite");
  for (std::size_t i = 0; i < d.size(); ++i)
    if (const auto& parameter = model.parameters[i]; !parameter.in_range(d[i]))
      return fail(ErrorCode::bad_camera,
                  fmt::format("{} has {} = {:f}, outside {}; its parameters are, in order, {}", name, parameter.name,
                              d[i], parameter.range, names(model.parameters)));
  return {};
}

}  // namespace

Result<Camera> Camera::make(CameraModel model, int width, int height, const std::vector<double>& intrinsics,
                            const std::vector<double>& distortion) {
  if (const auto image = check_image(width, height, intrinsics); !image) return propagate(image);
  if (const auto lens = check_distortion(facts(model), distortion); !lens) return propagate(lens);
  Camera camera;
  camera.model_ = model;
  camera.width_ = width;
  camera.height_ = height;
  camera.fx_ = intrinsics[0];
  camera.fy_ = intrinsics[1];
  camera.cx_ = intrinsics[2];
  camera.cy_ = intrinsics[3];
  camera.distortion_ = distortion;
  camera.distortion_.resize(facts(model).parameters.size(), 0.0);
  camera.lens_ = make_lens(model, camera.distortion_);
  camera.cone_rad_ = std::visit([](const auto& lens) { return lens.cone_rad(); }, camera.lens_);
  camera.min_cosine_ = std::cos(std::max(0.0, camera.cone_rad_ - cone_margin_rad));
  camera.max_angle_rad_ = camera.widest_angle_rad();
  return camera;
}

std::optional<Eigen::Vector2d> Camera::project(const Eigen::Vector3d& p_camera) const {
  const double range = p_camera.norm();
  if (!(range > 0 && std::isfinite(range) && p_camera.z() > min_cosine_ * range)) return std::nullopt;  // also NaN
  const Eigen::Vector2d m = std::visit([&](const auto& lens) { return lens.to_plane(p_camera, range); }, lens_);
  const Eigen::Vector2d uv(fx_ * m.x() + cx_, fy_ * m.y() + cy_);
  const bool inside = uv.x() >= -0.5 && uv.x() < width_ - 0.5 && uv.y() >= -0.5 && uv.y() < height_ - 0.5;
  if (!inside) return std::nullopt;
  return uv;
}

std::optional<Eigen::Vector3d> Camera::unproject(const Eigen::Vector2d& uv) const {
  const Eigen::Vector2d m((uv.x() - cx_) / fx_, (uv.y() - cy_) / fy_);
  if (!m.allFinite()) return std::nullopt;
  const auto bearing = std::visit([&](const auto& lens) { return lens.from_plane(m, cone_rad_); }, lens_);
  // Half the margin: what `project` gives must have its way back whatever the last digit.
  const double end_rad = std::max(0.0, cone_rad_ - 0.5 * cone_margin_rad);
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
      if (!bearing) return cone_rad_;
      least_cosine = std::min(least_cosine, bearing->z());
    }
  }
  return std::min(std::acos(least_cosine) + between_samples_rad, cone_rad_);
}

Result<Camera> Camera::resized(int width, int height) const {
  const double x = static_cast<double>(width) / width_, y = static_cast<double>(height) / height_;
  return make(model_, width, height, {fx_ * x, fy_ * y, (cx_ + 0.5) * x - 0.5, (cy_ + 0.5) * y - 0.5}, distortion_);
}

Result<CameraModel> parse_camera_model(std::string_view name) {
  const auto known = std::ranges::find(all_camera_models, name, &CameraModelFacts::name);
  if (known != all_camera_models.end()) return known->model;
  std::string names;
  for (const CameraModelFacts& model : all_camera_models)
    names += (names.empty() ? "" : ", ") + std::string(model.name);
  return fail(ErrorCode::bad_camera, "camera model '" + escape_control(name) + "' is not known; use one of " + names);
}

std::string_view to_string(CameraModel model) { return facts(model).name; }

}  // namespace calib
