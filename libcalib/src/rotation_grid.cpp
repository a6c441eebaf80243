#include "rotation_grid.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace calib {

std::vector<Eigen::Quaterniond> rotations_within(double reach_rad, double spacing_rad) {
  std::vector<Eigen::Quaterniond> rotations{Eigen::Quaterniond::Identity()};
  const int steps = static_cast<int>(reach_rad / spacing_rad);
  for (int i = -steps; i <= steps; ++i)
    for (int j = -steps; j <= steps; ++j)
      for (int k = -steps; k <= steps; ++k) {
        const Eigen::Vector3d vector = Eigen::Vector3d(i, j, k) * spacing_rad;
        const double angle = vector.norm();
        if (angle == 0 || angle > reach_rad * (1 + 1e-9)) continue;
        rotations.emplace_back(Eigen::AngleAxisd(angle, vector / angle));
      }
  return rotations;
}

std::vector<Eigen::Quaterniond> rotations_everywhere(double reach_rad, double spacing_rad) {
  // Rotations by angle form a space of volume 8 pi^2, of which each takes sqrt 2 spacing^3.
  constexpr double pi = std::numbers::pi;
  const auto count =
      static_cast<std::size_t>(std::ceil(8 * pi * pi * std::numbers::sqrt2 / 2 / std::pow(spacing_rad, 3)));
  constexpr double phi = std::numbers::sqrt2, psi = 1.533751168755204288118041;
  std::vector<Eigen::Quaterniond> rotations;
  for (std::size_t i = 0; i < count; ++i) {
    const double s = static_cast<double>(i) + 0.5, share = s / static_cast<double>(count);
    const double r = std::sqrt(share), R = std::sqrt(1 - share), alpha = 2 * pi * s / phi, beta = 2 * pi * s / psi;
    const Eigen::Quaterniond q(R * std::cos(beta), r * std::sin(alpha), r * std::cos(alpha), R * std::sin(beta));
    if (2 * std::acos(std::min(1.0, std::abs(q.w()))) <= reach_rad) rotations.push_back(q);
  }
  return rotations;
}

}  // namespace calib
