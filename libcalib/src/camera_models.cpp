#include "camera_models.hpp"

#include <algorithm>
#include <Eigen/LU>
#include <cmath>
#include <numbers>

namespace calib::lens {
namespace {

using Eigen::Matrix2d;
using Eigen::Vector2d;
using Eigen::Vector3d;

/// Where `positive` stops to hold between `inside`, where it does, and `outside`, where it does not.
template <typename Predicate>
double boundary(double inside, double outside, const Predicate& positive) {
  for (int i = 0; i < 60; ++i) {
    const double middle = 0.5 * (inside + outside);
    (positive(middle) ? inside : outside) = middle;
  }
  return inside;
}

/// Brown's distortion with OpenCV's rational radial factor: m' = f(s) m + 2 (q.m) m + s q, s = |m|^2, q = (p2, p1).
/// It is the gradient of a potential (its Jacobian is symmetric). On a disc where that Jacobian is positive definite,
/// the potential is convex: no two points of the disc have one image, and Newton's method finds the way back.
struct Brown {
  double k1, k2, p1, p2, k3, k4, k5, k6;

  struct Factor {
    double value, slope;  // f and df/ds
  };

  [[nodiscard]] double denominator(double s) const { return 1 + s * (k4 + s * (k5 + s * k6)); }

  [[nodiscard]] Factor factor(double s) const {
    const double bottom = denominator(s), value = (1 + s * (k1 + s * (k2 + s * k3))) / bottom;
    const double top_slope = k1 + s * (2 * k2 + s * 3 * k3), bottom_slope = k4 + s * (2 * k5 + s * 3 * k6);
    return {value, (top_slope - value * bottom_slope) / bottom};
  }

  [[nodiscard]] Vector2d distort(const Vector2d& m) const {
    const double s = m.squaredNorm(), x = m.x(), y = m.y(), f = factor(s).value;
    return {x * f + 2 * p1 * x * y + p2 * (s + 2 * x * x), y * f + p1 * (s + 2 * y * y) + 2 * p2 * x * y};
  }

  [[nodiscard]] Matrix2d jacobian(const Vector2d& m) const {
    const Vector2d q(p2, p1);
    const Factor f = factor(m.squaredNorm());
    return (f.value + 2 * q.dot(m)) * Matrix2d::Identity() + 2 * f.slope * m * m.transpose() +
           2 * (q * m.transpose() + m * q.transpose());
  }

  /// Smallest eigenvalue of the Jacobian on the circle |m|^2 = s. Along a direction v at cosine c to m it is at least
  /// f + 2 f' s c^2 - 2 |q| |m| sqrt(1 + 8 c^2), equal where q points the wrong way; that is convex in c^2.
  [[nodiscard]] double least_stretch(double s) const {
    if (!(denominator(s) > 0)) return -1;
    const Factor f = factor(s);
    const double pull = std::hypot(p1, p2) * std::sqrt(s);
    const double root = f.slope > 0 ? std::clamp(4 * pull / (f.slope * s), 1.0, 3.0) : 3.0;
    return f.value + f.slope * s * (root * root - 1) / 4 - 2 * pull * root;
  }

  /// Radius of the disc on which the distortion is one-to-one; at most 1000, 89.94 degrees off axis for a pinhole.
  [[nodiscard]] double fold_radius() const {
    constexpr double smallest = 1e-6, largest = 1e6, step = 1.002;
    const auto stretches = [this](double s) { return least_stretch(s) > 0; };
    double before = 0;
    for (double s = smallest; s < largest; before = s, s *= step)
      if (!stretches(s)) return std::sqrt(boundary(before, s, stretches));
    return std::sqrt(largest);
  }

  /// The point of the disc of radius `fold` that `distort` maps to `target`: Newton's method, with steps short enough
  /// to stay in the disc and to come closer each time.
  [[nodiscard]] std::optional<Vector2d> undistort(const Vector2d& target, double fold) const {
    Vector2d m = target * std::min(1.0, 0.9 * fold / (target.norm() + 1e-300));
    Vector2d miss = distort(m) - target;
    const double enough = 1e-13 * (1 + target.norm());
    for (int i = 0; i < 100 && miss.norm() > 0.01 * enough; ++i) {
      Vector2d step = jacobian(m).inverse() * miss;
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
};

bool has_brown(CameraModel model) {
  return model == CameraModel::plumb_bob || model == CameraModel::rational_polynomial || model == CameraModel::mei;
}

Brown brown(CameraModel model, const std::vector<double>& d) {
  if (model == CameraModel::mei) return {d[1], d[2], d[3], d[4], 0, 0, 0, 0};
  if (model == CameraModel::rational_polynomial) return {d[0], d[1], d[2], d[3], d[4], d[5], d[6], d[7]};
  return {d[0], d[1], d[2], d[3], d[4], 0, 0, 0};
}

/// A pinhole is a mirror of xi = 0.
double mirror_xi(CameraModel model, const std::vector<double>& d) { return model == CameraModel::mei ? d[0] : 0; }

/// The unit bearing that a mirror shows at `m`; nothing outside a mirror's outline.
std::optional<Vector3d> from_mirror(double xi, const Vector2d& m) {
  const double s = m.squaredNorm(), radicand = 1 + (1 - xi * xi) * s;
  if (!(radicand >= 0)) return std::nullopt;
  const double scale = (xi + std::sqrt(radicand)) / (1 + s);
  return Vector3d(scale * m.x(), scale * m.y(), scale - xi);
}

double theta_image(const std::vector<double>& k, double theta) {
  const double s = theta * theta;
  return theta * (1 + s * (k[0] + s * (k[1] + s * (k[2] + s * k[3]))));
}

double theta_slope(const std::vector<double>& k, double theta) {
  const double s = theta * theta;
  return 1 + s * (3 * k[0] + s * (5 * k[1] + s * (7 * k[2] + s * 9 * k[3])));
}

double theta_fold(const std::vector<double>& k) {
  const auto grows = [&](double theta) { return theta_slope(k, theta) > 0; };
  constexpr int steps = 1 << 14;
  for (int i = 1; i <= steps; ++i) {
    const double theta = std::numbers::pi * i / steps;
    if (!grows(theta)) return boundary(theta - std::numbers::pi / steps, theta, grows);
  }
  return std::numbers::pi;
}

/// Newton's method inside a bracket that halves where a step would leave it: the polynomial grows up to `fold`.
std::optional<double> theta_of(const std::vector<double>& k, double image, double fold) {
  double low = 0, high = fold, theta = std::min(image, 0.9 * fold);
  if (!(image <= theta_image(k, fold))) return std::nullopt;
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

std::optional<Vector3d> from_equidistant(const std::vector<double>& k, const Vector2d& m, double fold) {
  const double image = m.norm();
  if (image == 0) return Vector3d::UnitZ();
  const auto theta = theta_of(k, image, fold);
  if (!theta) return std::nullopt;
  const Vector2d across = m * (std::sin(*theta) / image);
  return Vector3d(across.x(), across.y(), std::cos(*theta));
}

/// z of the point (m, z) on the ray of the unified model that double_sphere and eucm share; s = |m|^2, times beta for
/// eucm. Nothing outside the outline.
std::optional<double> unified_z(double alpha, double s) {
  const double radicand = 1 - (2 * alpha - 1) * s;
  if (!(radicand >= 0)) return std::nullopt;
  return (1 - alpha * alpha * s) / (alpha * std::sqrt(radicand) + 1 - alpha);
}

/// Up to one half the denominator limits what is seen, above that the outline does.
double unified_limit(double alpha) { return alpha <= 0.5 ? alpha / (1 - alpha) : (1 - alpha) / alpha; }

double double_sphere_fold(double xi, double alpha) {
  const double w1 = unified_limit(alpha), v = 1 - w1 * w1;
  const double published = (w1 + xi) / std::sqrt(2 * w1 * xi + xi * xi + 1);
  // Solves (cosine + xi) / |bearing + xi axis| = -w1: where the second sphere ends. Tighter for xi < 0, small alpha.
  const double second_sphere = xi * v + w1 * std::sqrt(1 - xi * xi * v);
  return std::acos(-std::clamp(std::min(published, second_sphere), -1.0, 1.0));
}

std::optional<Vector3d> from_double_sphere(double xi, double alpha, const Vector2d& m) {
  const double s = m.squaredNorm();
  const auto z = unified_z(alpha, s);
  if (!z) return std::nullopt;
  const double radicand = *z * *z + (1 - xi * xi) * s;
  const double scale = (*z * xi + std::sqrt(radicand)) / (*z * *z + s);
  return Vector3d(scale * m.x(), scale * m.y(), scale * *z - xi);
}

std::optional<Vector3d> from_eucm(double alpha, double beta, const Vector2d& m) {
  const auto z = unified_z(alpha, beta * m.squaredNorm());
  if (!z) return std::nullopt;
  return Vector3d(m.x(), m.y(), *z).normalized();
}

}  // namespace

double fold_angle_rad(CameraModel model, const std::vector<double>& d) {
  if (has_brown(model)) {
    const double xi = mirror_xi(model, d);
    const auto bearing = from_mirror(xi, {brown(model, d).fold_radius(), 0});
    return bearing ? std::atan2(bearing->x(), bearing->z()) : std::acos(-1 / xi);
  }
  if (model == CameraModel::equidistant) return theta_fold(d);
  if (model == CameraModel::double_sphere) return double_sphere_fold(d[0], d[1]);
  if (model == CameraModel::eucm) {
    const double w = unified_limit(d[0]);
    return std::atan2(std::sqrt((1 - w * w) / d[1]), -w);
  }
  return std::numbers::pi / 2;
}

Vector2d to_plane(CameraModel model, const std::vector<double>& d, const Vector3d& p, double range) {
  const Vector2d across = p.head<2>();
  if (has_brown(model)) return brown(model, d).distort(across / (p.z() + mirror_xi(model, d) * range));
  if (model == CameraModel::equidistant) {
    const double sine = across.norm();
    if (sine == 0) return Vector2d::Zero();
    return across * (theta_image(d, std::atan2(sine, p.z())) / sine);
  }
  if (model == CameraModel::double_sphere) {
    const double shifted_z = d[0] * range + p.z();
    return across / (d[1] * std::hypot(across.x(), across.y(), shifted_z) + (1 - d[1]) * shifted_z);
  }
  if (model == CameraModel::eucm)
    return across / (d[0] * std::sqrt(d[1] * across.squaredNorm() + p.z() * p.z()) + (1 - d[0]) * p.z());
  return across / p.z();
}

std::optional<Vector3d> from_plane(CameraModel model, const std::vector<double>& d, const Vector2d& m,
                                   double fold_rad) {
  if (has_brown(model)) {
    const double xi = mirror_xi(model, d);
    const auto straight = brown(model, d).undistort(m, std::sin(fold_rad) / (std::cos(fold_rad) + xi));
    return straight ? from_mirror(xi, *straight) : std::nullopt;
  }
  if (model == CameraModel::equidistant) return from_equidistant(d, m, fold_rad);
  if (model == CameraModel::double_sphere) return from_double_sphere(d[0], d[1], m);
  if (model == CameraModel::eucm) return from_eucm(d[0], d[1], m);
  return Vector3d(m.x(), m.y(), 1).normalized();
}

}  // namespace calib::lens
