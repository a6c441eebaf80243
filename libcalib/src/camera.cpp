#include "calib/camera.hpp"

#include <algorithm>
#include <Eigen/LU>
#include <cmath>
#include <limits>

namespace calib {
namespace {

/// Square of the smallest radius at which r (1 + k1 r^2 + k2 r^4 + k3 r^6) stops growing; infinite when it never does.
double monotonic_radius_squared(double k1, double k2, double k3) {
  // Its derivative, in s = r^2: 1 + 3 k1 s + 5 k2 s^2 + 7 k3 s^3. First sign change by scanning, then bisection:
  // robust for every degree, and done once per camera.
  const auto slope = [&](double s) { return 1 + s * (3 * k1 + s * (5 * k2 + s * 7 * k3)); };
  constexpr double largest = 1e4;  // 89.4 degrees off axis
  double before = 0;
  for (double s = 1e-3; s < largest; s *= 1.01) {
    if (slope(s) <= 0) {
      double after = s;
      for (int i = 0; i < 60; ++i) {
        const double middle = 0.5 * (before + after);
        (slope(middle) > 0 ? before : after) = middle;
      }
      return before;
    }
    before = s;
  }
  return std::numeric_limits<double>::infinity();
}

}  // namespace

Result<Camera> Camera::make(CameraModel model, int width, int height, const std::vector<double>& intrinsics,
                            const std::vector<double>& distortion) {
  if (width < 16 || height < 16 || static_cast<std::int64_t>(width) * height > 64'000'000)
    return fail("bad_camera", "image size " + std::to_string(width) + " x " + std::to_string(height) +
                                  " is outside 16 x 16 .. 64 Mpx");
  if (intrinsics.size() != 4) return fail("bad_camera", "intrinsics are four numbers: fx, fy, cx, cy (pixels)");
  const auto finite = [](double value) { return std::isfinite(value); };
  if (!std::ranges::all_of(intrinsics, finite) || !std::ranges::all_of(distortion, finite))
    return fail("bad_camera", "intrinsics or distortion hold a number that is not finite");
  for (int i = 0; i < 2; ++i)
    if (intrinsics[i] <= 1 || intrinsics[i] >= 1e5)
      return fail("bad_camera", "focal length " + std::to_string(intrinsics[i]) + " is outside 1 .. 1e5 pixels");
  if (model == CameraModel::rectified && !distortion.empty())
    return fail("bad_camera", "model rectified has no distortion; use plumb_bob for a raw image");
  if (model == CameraModel::plumb_bob && distortion.size() != 4 && distortion.size() != 5)
    return fail("bad_camera", "model plumb_bob needs distortion k1, k2, p1, p2 and, optionally, k3");

  Camera camera;
  camera.model_ = model;
  camera.width_ = width;
  camera.height_ = height;
  camera.fx_ = intrinsics[0];
  camera.fy_ = intrinsics[1];
  camera.cx_ = intrinsics[2];
  camera.cy_ = intrinsics[3];
  camera.distortion_ = distortion;
  camera.max_radius_squared_ = std::numeric_limits<double>::infinity();
  if (model == CameraModel::plumb_bob) {
    camera.distortion_.resize(5, 0.0);
    camera.max_radius_squared_ =
        monotonic_radius_squared(camera.distortion_[0], camera.distortion_[1], camera.distortion_[4]);
  }
  return camera;
}

Eigen::Vector2d Camera::distort(const Eigen::Vector2d& p) const {
  const auto &k1 = distortion_[0], &k2 = distortion_[1], &p1 = distortion_[2], &p2 = distortion_[3],
             &k3 = distortion_[4];
  const double x = p.x(), y = p.y(), r2 = p.squaredNorm();
  const double radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3));
  return {x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y};
}

std::optional<Eigen::Vector2d> Camera::project(const Eigen::Vector3d& p_camera) const {
  if (!(p_camera.z() > 1e-6)) return std::nullopt;  // also NaN
  Eigen::Vector2d normalised = p_camera.head<2>() / p_camera.z();
  if (model_ == CameraModel::plumb_bob) {
    if (!(normalised.squaredNorm() < max_radius_squared_)) return std::nullopt;
    normalised = distort(normalised);
  }
  const Eigen::Vector2d uv(fx_ * normalised.x() + cx_, fy_ * normalised.y() + cy_);
  const bool inside = uv.x() >= -0.5 && uv.x() < width_ - 0.5 && uv.y() >= -0.5 && uv.y() < height_ - 0.5;
  if (!inside) return std::nullopt;
  return uv;
}

std::optional<Eigen::Vector3d> Camera::unproject(const Eigen::Vector2d& uv) const {
  const Eigen::Vector2d distorted((uv.x() - cx_) / fx_, (uv.y() - cy_) / fy_);
  if (!distorted.allFinite()) return std::nullopt;
  Eigen::Vector2d p = distorted;
  if (model_ == CameraModel::plumb_bob) {
    // Newton's method with a numeric Jacobian; the map is smooth and monotonic inside its domain of validity.
    for (int i = 0; i < 50; ++i) {
      const Eigen::Vector2d residual = distort(p) - distorted;
      if (residual.squaredNorm() < 1e-26) break;
      constexpr double h = 1e-7;
      Eigen::Matrix2d J;
      J.col(0) = (distort(p + Eigen::Vector2d(h, 0)) - distort(p - Eigen::Vector2d(h, 0))) / (2 * h);
      J.col(1) = (distort(p + Eigen::Vector2d(0, h)) - distort(p - Eigen::Vector2d(0, h))) / (2 * h);
      if (std::abs(J.determinant()) < 1e-12) return std::nullopt;
      p -= J.inverse() * residual;
    }
    if (!p.allFinite() || !(p.squaredNorm() < max_radius_squared_) || (distort(p) - distorted).norm() > 1e-9)
      return std::nullopt;
  }
  return Eigen::Vector3d(p.x(), p.y(), 1).normalized();
}

Result<CameraModel> parse_camera_model(std::string_view name) {
  if (name == "rectified") return CameraModel::rectified;
  if (name == "plumb_bob") return CameraModel::plumb_bob;
  return fail("bad_camera", "camera model '" + escape_control(name) + "' is not known; use rectified or plumb_bob");
}

std::string_view to_string(CameraModel model) {
  return model == CameraModel::rectified ? "rectified" : "plumb_bob";
}

}  // namespace calib
