#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>

#include "calib/drift.hpp"

namespace calib {
namespace {

constexpr int least_estimate_pairs = 3;
/// An axis is taken to have moved when that explains as much.
constexpr double significant_sigmas = 3;
/// Slopes change in proportion to a shift up to a relative error of this share.
constexpr double nonlinear_share = 0.1;
/// A translation must explain the slopes better than a rotation by so much, in squared standard deviations.
constexpr double translation_penalty = 1;
/// Variance of the median of many normal values, in that of their mean.
constexpr double median_variance = 1.57;

double median(std::vector<double> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::ranges::nth_element(values, middle);
  if (values.size() % 2 == 1) return *middle;
  return (*middle + *std::max_element(values.begin(), middle)) / 2;
}

using Axes = std::array<bool, 6>;
constexpr Axes all_axes{true, true, true, true, true, true};

/// Slopes that are `away` from the baseline, to be explained by shifts with a standard normal prior; `sensitivity` is
/// the change of the slopes with the shifts.
struct Explanation {
  Vector6 away = Vector6::Zero();
  Matrix6 sensitivity = Matrix6::Zero(), information = Matrix6::Zero();

  /// Inverse covariance of the shifts when only these axes may move; the others keep that of the prior.
  [[nodiscard]] Matrix6 precision(const Axes& moved) const {
    Matrix6 of_moved = sensitivity;
    for (int axis = 0; axis < 6; ++axis)
      if (!moved[static_cast<std::size_t>(axis)]) of_moved.col(axis).setZero();
    return of_moved.transpose() * information * of_moved + Matrix6::Identity();
  }
  [[nodiscard]] Vector6 shift(const Axes& moved) const {
    Vector6 pull = sensitivity.transpose() * information * away;
    for (int axis = 0; axis < 6; ++axis)
      if (!moved[static_cast<std::size_t>(axis)]) pull[axis] = 0;
    return precision(moved).ldlt().solve(pull);
  }
  /// The residual, in squared standard deviations.
  [[nodiscard]] double misfit(const Axes& moved) const {
    const Vector6 x = shift(moved), left = away - sensitivity * x;
    return left.dot(information * left) + x.squaredNorm();
  }

  /// Each axis by its own slope where that is significant. Outside the basin slopes do not add up, but their signs
  /// hold.
  [[nodiscard]] Vector6 each_alone() const {
    Vector6 shifts = Vector6::Zero();
    for (int axis = 0; axis < 6; ++axis)
      if (sensitivity(axis, axis) > 0 && std::abs(away[axis]) > significant_sigmas)
        shifts[axis] = away[axis] / sensitivity(axis, axis);
    return shifts;
  }

  /// Forward selection: axis after axis the one that explains most, as long as the gain is significant.
  [[nodiscard]] Vector6 simplest() const {
    Axes moved{};
    double misfit_before = misfit(moved);
    while (moved != all_axes) {
      std::optional<std::size_t> best;
      double least = misfit_before - significant_sigmas * significant_sigmas;
      for (std::size_t axis = 0; axis < 6; ++axis) {
        if (moved[axis]) continue;
        Axes with = moved;
        with[axis] = true;
        // A mount bends more easily than it slides.
        if (const double left = misfit(with) + (axis < 3 ? 0 : translation_penalty); left < least) {
          least = left;
          best = axis;
        }
      }
      if (!best) break;
      moved[*best] = true;
      misfit_before = misfit(moved);
    }
    return shift(moved);
  }
};

}  // namespace

std::optional<Misalignment> DriftMonitor::misalignment() const {
  if (!learned()) return std::nullopt;
  const DriftBaseline& baseline = state_.baseline;
  // Pairs from before the drift began would dilute the estimate.
  const Timestamp from = onset().value_or(Timestamp::min());
  std::array<std::vector<double>, 6> seen;
  for (const AxisEvidence& evidence : state_.recent)
    if (evidence.stamp >= from)
      for (std::size_t axis = 0; axis < 6; ++axis)
        seen[axis].push_back(evidence.slope[static_cast<Eigen::Index>(axis)]);
  const auto pairs = static_cast<int>(seen[0].size());
  if (pairs < least_estimate_pairs) return std::nullopt;

  // In units of one pair's spread (rows) and of the prior (columns).
  Vector6 weight = Vector6::Zero(), prior;
  Explanation problem;
  for (int axis = 0; axis < 6; ++axis) {
    prior[axis] = StencilStep{}.of_axis(axis);
    if (baseline.spread(axis) > 0) weight[axis] = 1 / baseline.spread(axis);
    problem.away[axis] = (median(seen[static_cast<std::size_t>(axis)]) - baseline.slope[axis]) * weight[axis];
    if (baseline.observable(axis)) problem.sensitivity.col(axis) = baseline.sensitivity.col(axis) * prior[axis];
  }
  problem.sensitivity = weight.asDiagonal() * problem.sensitivity;
  const Matrix6 spread = weight.asDiagonal() * baseline.slope_products * weight.asDiagonal() / (baseline.pairs - 1);
  const Vector6 curved = nonlinear_share * problem.away;
  const Matrix6 noise = spread * (median_variance / pairs + 1.0 / baseline.pairs) +
                        Matrix6(curved.cwiseAbs2().asDiagonal()) + 1e-9 * Matrix6::Identity();
  problem.information = noise.inverse();
  const Vector6 farthest = 2 * prior;
  Misalignment estimate{prior.cwiseProduct(maximum_is_lost() ? problem.each_alone() : problem.simplest()),
                        prior.asDiagonal() * problem.precision(all_axes).inverse() * prior.asDiagonal()};
  estimate.delta = estimate.delta.cwiseMax(-farthest).cwiseMin(farthest);
  if (maximum_is_lost()) estimate.covariance = farthest.cwiseAbs2().asDiagonal();
  return estimate;
}

Misalignment DriftMonitor::with_bias(Misalignment found, const SearchBounds& bounds) const {
  const DriftBaseline& baseline = state_.baseline;
  for (int axis = 0; axis < 6; ++axis) {
    double bias = axis < 3 ? settings_.max_bias_rotation_rad : settings_.max_bias_translation_m;
    if (learned() && baseline.observable(axis)) bias = baseline.slope[axis] / baseline.sensitivity(axis, axis);
    const double bound = axis < 3 ? bounds.rotation_rad : bounds.translation_m;
    found.covariance(axis, axis) += std::pow(std::min(std::abs(bias), bound), 2);
  }
  return found;
}

}  // namespace calib
