#include "calib_eval/starts.hpp"

#include <cmath>
#include <numbers>
#include <numeric>
#include <utility>

#include "vehicle/random.hpp"

namespace calib::eval {
namespace {

constexpr double metres_per_cm = 0.01;

/// Shoemake, "Uniform Random Rotations", Graphics Gems III, 1992.
Eigen::Quaterniond uniform_rotation(vehicle::Random& random) {
  const double u = random.uniform(0, 1);
  const double first = 2 * std::numbers::pi * random.uniform(0, 1);
  const double second = 2 * std::numbers::pi * random.uniform(0, 1);
  const double a = std::sqrt(1 - u), b = std::sqrt(u);
  return {b * std::cos(second), a * std::sin(first), a * std::cos(first), b * std::sin(second)};
}

/// The numbers below `count` in an order that is always the same one (Fisher and Yates 1938).
std::vector<int> shuffled(int count) {
  std::vector<int> order(count);
  std::iota(order.begin(), order.end(), 0);
  vehicle::Random random(0x53687566666c65U);
  for (int i = count - 1; i > 0; --i) std::swap(order[i], order[random.below(i + 1)]);
  return order;
}

}  // namespace

Eigen::Vector3d fibonacci_point(int index, int count) {
  const double z = 1 - (2.0 * index + 1) / count;
  const double radius = std::sqrt(1 - z * z);
  const double azimuth = index * std::numbers::pi * (3 - std::sqrt(5.0));
  return {radius * std::cos(azimuth), radius * std::sin(azimuth), z};
}

std::vector<RigidTransform> starting_motions(const ErrorRange& range, bool with_translation, int count,
                                             std::uint64_t seed) {
  vehicle::Random random(vehicle::mix(seed, 0x5374617274U));
  const std::vector<int> other = shuffled(count);
  std::vector<RigidTransform> motions;
  for (int i = 0; i < count; ++i) {
    Vector6 delta = Vector6::Zero();
    if (!range.any_orientation()) delta.head<3>() = fibonacci_point(i, count) * range.rotation_deg * radians_per_degree;
    if (with_translation) delta.tail<3>() = fibonacci_point(other[i], count) * range.translation_cm * metres_per_cm;
    RigidTransform motion = perturbation(delta);
    if (range.any_orientation()) motion.linear() = uniform_rotation(random).toRotationMatrix();
    motions.push_back(motion);
  }
  return motions;
}

SearchBounds search_bounds(const ErrorRange& range) {
  return {(1.25 * range.rotation_deg + 1) * radians_per_degree, (1.25 * range.translation_cm + 10) * metres_per_cm};
}

SearchBounds reach(const ErrorRange& range) {
  const SearchBounds bounds = search_bounds(range);
  return {bounds.rotation_rad + range.rotation_deg * radians_per_degree,
          bounds.translation_m + range.translation_cm * metres_per_cm};
}

}  // namespace calib::eval
