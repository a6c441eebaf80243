#pragma once

#include <Eigen/Geometry>
#include <vector>

namespace calib {

/// Rotations by at most `reach_rad` about any axis: a cubic grid of rotation vectors, `spacing_rad` apart, the identity
/// first. For reaches up to about a radian, where rotation vectors are nearly a flat space.
[[nodiscard]] std::vector<Eigen::Quaterniond> rotations_within(double reach_rad, double spacing_rad);

/// Rotations by at most `reach_rad` (pi: all there are), spread evenly over SO(3), about `spacing_rad` apart: a
/// super-Fibonacci spiral (Alexa 2022).
[[nodiscard]] std::vector<Eigen::Quaterniond> rotations_everywhere(double reach_rad, double spacing_rad);

}  // namespace calib
