#include <Eigen/LU>
#include <algorithm>
#include <cmath>

#include "boundary.hpp"
#include "calib/camera_models.hpp"

namespace calib::camera_models {
namespace {

using Eigen::Matrix2d;
using Eigen::Vector2d;
using Eigen::Vector3d;

struct Factor {
  double value, slope;  // f and df/ds, s = |m|^2
};

double denominator(const Brown& b, double s) { return 1 + s * (b.k4 + s * (b.k5 + s * b.k6)); }

Factor factor(const Brown& b, double s) {
  const double bottom = denominator(b, s), value = (1 + s * (b.k1 + s * (b.k2 + s * b.k3))) / bottom;
  const double top_slope = b.k1 + s * (2 * b.k2 + s * 3 * b.k3), bottom_slope = b.k4 + s * (2 * b.k5 + s * 3 * b.k6);
  return {value, (top_slope - value * bottom_slope) / bottom};
}

// The distortion is m' = f(s) m + 2 (q.m) m + s q, q = (p2, p1). It is the gradient of a potential (its Jacobian is
// symmetric). On a disc where that Jacobian is positive definite, the potential is convex: no two points of the disc
// have one image, and Newton's method finds the way back.

Matrix2d jacobian(const Brown& b, const Vector2d& m) {
  const Vector2d q(b.p2, b.p1);
  const Factor f = factor(b, m.squaredNorm());
  return (f.value + 2 * q.dot(m)) * Matrix2d::Identity() + 2 * f.slope * m * m.transpose() +
         2 * (q * m.transpose() + m * q.transpose());
}

/// Smallest eigenvalue of the Jacobian on the circle |m|^2 = s. Along a direction v at cosine c to m it is at least
/// f + 2 f' s c^2 - 2 |q| |m| sqrt(1 + 8 c^2), equal where q points the wrong way; that is convex in c^2.
double least_stretch(const Brown& b, double s) {
  if (!(denominator(b, s) > 0)) return -1;
  const Factor f = factor(b, s);
  const double pull = std::hypot(b.p1, b.p2) * std::sqrt(s);
  const double root = f.slope > 0 ? std::clamp(4 * pull / (f.slope * s), 1.0, 3.0) : 3.0;
  return f.value + f.slope * s * (root * root - 1) / 4 - 2 * pull * root;
}

/// The unit bearing that a mirror of eccentricity `xi` shows at `m`; nothing outside its outline. A pinhole is a mirror
/// of xi = 0.
Bearing from_mirror(double xi, const Vector2d& m) {
  const double s = m.squaredNorm(), radicand = 1 + (1 - xi * xi) * s;
  if (!(radicand >= 0)) return std::nullopt;
  const double scale = (xi + std::sqrt(radicand)) / (1 + s);
  return Vector3d(scale * m.x(), scale * m.y(), scale - xi);
}

double mirror_cone_rad(double xi, const Brown& brown) {
  const auto bearing = from_mirror(xi, {brown.fold_radius(), 0});
  return bearing ? std::atan2(bearing->x(), bearing->z()) : std::acos(-1 / xi);
}

Bearing from_distorted_mirror(double xi, const Brown& brown, const Vector2d& m, double cone_rad) {
  const auto straight = brown.undistort(m, std::sin(cone_rad) / (std::cos(cone_rad) + xi));
  return straight ? from_mirror(xi, *straight) : std::nullopt;
}

}  // namespace

Vector2d Brown::distort(const Vector2d& m) const {
  const double s = m.squaredNorm(), x = m.x(), y = m.y(), f = factor(*this, s).value;
  return {x * f + 2 * p1 * x * y + p2 * (s + 2 * x * x), y * f + p1 * (s + 2 * y * y) + 2 * p2 * x * y};
}

double Brown::fold_radius() const {
  constexpr double smallest = 1e-6, largest = 1e6, step = 1.002;
  const auto stretches = [this](double s) { return least_stretch(*this, s) > 0; };
  double before = 0;
  for (double s = smallest; s < largest; before = s, s *= step)
    if (!stretches(s)) return std::sqrt(boundary(before, s, stretches));
  return std::sqrt(largest);
}

/// Newton's method, with steps short enough to stay in the disc and to come closer each time.
std::optional<Vector2d> Brown::undistort(const Vector2d& target, double fold) const {
  Vector2d m = target * std::min(1.0, 0.9 * fold / (target.norm() + 1e-300));
  Vector2d miss = distort(m) - target;
  const double enough = 1e-13 * (1 + target.norm());
  for (int i = 0; i < 100 && miss.norm() > 0.01 * enough; ++i) {
    Vector2d step = jacobian(*this, m).inverse() * miss;
    bool closer = false;
    for (int halvings = 0; halvings < 30 && !closer; ++halvings, step *= 0.5) {
      const Vector2d next = m - step, next_miss = distort(next) - target;
      closer = next.norm() <= fold && next_miss.norm() < miss.norm();
      if (closer) m = next, miss = next_miss;
    }
    if (!closer) break;
  }
  if (!(miss.norm() <= enough)) return std::nullopt;
  return m;
}

PlumbBob::PlumbBob(std::span<const double> d) : brown{d[0], d[1], d[2], d[3], d[4]} {}
double PlumbBob::cone_rad() const { return mirror_cone_rad(0, brown); }
Vector2d PlumbBob::to_plane(const Vector3d& p, double) const { return brown.distort(p.head<2>() / p.z()); }
Bearing PlumbBob::from_plane(const Vector2d& m, double cone_rad) const {
  return from_distorted_mirror(0, brown, m, cone_rad);
}

RationalPolynomial::RationalPolynomial(std::span<const double> d)
    : brown{d[0], d[1], d[2], d[3], d[4], d[5], d[6], d[7]} {}
double RationalPolynomial::cone_rad() const { return mirror_cone_rad(0, brown); }
Vector2d RationalPolynomial::to_plane(const Vector3d& p, double) const { return brown.distort(p.head<2>() / p.z()); }
Bearing RationalPolynomial::from_plane(const Vector2d& m, double cone_rad) const {
  return from_distorted_mirror(0, brown, m, cone_rad);
}

Mei::Mei(std::span<const double> d) : xi(d[0]), brown{d[1], d[2], d[3], d[4]} {}
double Mei::cone_rad() const { return mirror_cone_rad(xi, brown); }
Vector2d Mei::to_plane(const Vector3d& p, double range) const {
  return brown.distort(p.head<2>() / (p.z() + xi * range));
}
Bearing Mei::from_plane(const Vector2d& m, double cone_rad) const {
  return from_distorted_mirror(xi, brown, m, cone_rad);
}

}  // namespace calib::camera_models
