#include <algorithm>
#include <cmath>
#include <numbers>

#include "boundary.hpp"
#include "calib/camera_models.hpp"

namespace calib::camera_models {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

double theta_image(const Equidistant& k, double theta) {
  const double s = theta * theta;
  return theta * (1 + s * (k.k1 + s * (k.k2 + s * (k.k3 + s * k.k4))));
}

double theta_slope(const Equidistant& k, double theta) {
  const double s = theta * theta;
  return 1 + s * (3 * k.k1 + s * (5 * k.k2 + s * (7 * k.k3 + s * 9 * k.k4)));
}

/// Newton's method inside a bracket that halves where a step would leave it: the polynomial grows up to `cone_rad`.
std::optional<double> theta_of(const Equidistant& k, double image, double cone_rad) {
  double low = 0, high = cone_rad, theta = std::min(image, 0.9 * cone_rad);
  if (!(image <= theta_image(k, cone_rad))) return std::nullopt;
  for (int i = 0; i < 100; ++i) {
    const double miss = theta_image(k, theta) - image;
    (miss > 0 ? high : low) = theta;
    double next = theta - miss / theta_slope(k, theta);
    if (!(next >= low && next <= high)) next = 0.5 * (low + high);
    const double step = std::abs(next - theta);
    theta = next;
    if (step <= 1e-15) break;
  }
  return theta;
}

}  // namespace

Equidistant::Equidistant(std::span<const double> d) : k1(d[0]), k2(d[1]), k3(d[2]), k4(d[3]) {}

double Equidistant::cone_rad() const {
  const auto grows = [&](double theta) { return theta_slope(*this, theta) > 0; };
  constexpr int steps = 1 << 14;
  for (int i = 1; i <= steps; ++i) {
    const double theta = std::numbers::pi * i / steps;
    if (!grows(theta)) return boundary(theta - std::numbers::pi / steps, theta, grows);
  }
  return std::numbers::pi;
}

Vector2d Equidistant::to_plane(const Vector3d& p, double) const {
  const Vector2d across = p.head<2>();
  const double sine = across.norm();
  if (sine == 0) return Vector2d::Zero();
  return across * (theta_image(*this, std::atan2(sine, p.z())) / sine);
}

Bearing Equidistant::from_plane(const Vector2d& m, double cone_rad) const {
  const double image = m.norm();
  if (image == 0) return Vector3d::UnitZ();
  const auto theta = theta_of(*this, image, cone_rad);
  if (!theta) return std::nullopt;
  const Vector2d across = m * (std::sin(*theta) / image);
  return Vector3d(across.x(), across.y(), std::cos(*theta));
}

}  // namespace calib::camera_models
