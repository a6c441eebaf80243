#include <algorithm>
#include <cmath>

#include "calib/camera_models.hpp"

namespace calib::camera_models {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

/// z of the point (m, z) on the ray of the unified model that double_sphere and eucm share; s = |m|^2, times beta for
/// eucm. Nothing outside the outline.
std::optional<double> unified_z(double alpha, double s) {
  const double radicand = 1 - (2 * alpha - 1) * s;
  if (!(radicand >= 0)) return std::nullopt;
  return (1 - alpha * alpha * s) / (alpha * std::sqrt(radicand) + 1 - alpha);
}

/// Up to one half the denominator limits what is seen, above that the outline does.
double unified_limit(double alpha) { return alpha <= 0.5 ? alpha / (1 - alpha) : (1 - alpha) / alpha; }

}  // namespace

DoubleSphere::DoubleSphere(std::span<const double> d) : xi(d[0]), alpha(d[1]) {}

double DoubleSphere::cone_rad() const {
  const double w1 = unified_limit(alpha), v = 1 - w1 * w1;
  const double published = (w1 + xi) / std::sqrt(2 * w1 * xi + xi * xi + 1);
  // Solves (cosine + xi) / |bearing + xi axis| = -w1: where the second sphere ends. Tighter for xi < 0, small alpha.
  const double second_sphere = xi * v + w1 * std::sqrt(1 - xi * xi * v);
  return std::acos(-std::clamp(std::min(published, second_sphere), -1.0, 1.0));
}

Vector2d DoubleSphere::to_plane(const Vector3d& p, double range) const {
  const Vector2d across = p.head<2>();
  const double shifted_z = xi * range + p.z();
  return across / (alpha * std::hypot(across.x(), across.y(), shifted_z) + (1 - alpha) * shifted_z);
}

Bearing DoubleSphere::from_plane(const Vector2d& m, double) const {
  const double s = m.squaredNorm();
  const auto z = unified_z(alpha, s);
  if (!z) return std::nullopt;
  const double radicand = *z * *z + (1 - xi * xi) * s;
  const double scale = (*z * xi + std::sqrt(radicand)) / (*z * *z + s);
  return Vector3d(scale * m.x(), scale * m.y(), scale * *z - xi);
}

Eucm::Eucm(std::span<const double> d) : alpha(d[0]), beta(d[1]) {}

double Eucm::cone_rad() const {
  const double w = unified_limit(alpha);
  return std::atan2(std::sqrt((1 - w * w) / beta), -w);
}

Vector2d Eucm::to_plane(const Vector3d& p, double) const {
  const Vector2d across = p.head<2>();
  return across / (alpha * std::sqrt(beta * across.squaredNorm() + p.z() * p.z()) + (1 - alpha) * p.z());
}

Bearing Eucm::from_plane(const Vector2d& m, double) const {
  const auto z = unified_z(alpha, beta * m.squaredNorm());
  if (!z) return std::nullopt;
  return Vector3d(m.x(), m.y(), *z).normalized();
}

}  // namespace calib::camera_models
