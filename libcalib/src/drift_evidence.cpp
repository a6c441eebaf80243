#include <algorithm>
#include <cmath>
#include <limits>

#include "calib/drift.hpp"

namespace calib {
namespace {

/// An axis is observable when its mean sensitivity is this many standard errors above zero.
constexpr double observable_sigmas = 3;
/// Of consecutive pairs; a larger estimate is a trend.
constexpr double max_correlation = 0.6;

/// Half widths of the shifts that the sensitivity is measured with: as large as the shifts that must be detected.
constexpr StencilStep sensitivity_shift{.rotation_rad = 0.4 * radians_per_degree, .translation_m = 0.1};

double deviation(double sum_of_squares, int count) { return count < 2 ? 0 : std::sqrt(sum_of_squares / (count - 1)); }

/// Standard deviation of one of `count` values as it contributes to long sums.
double long_deviation(double sum_of_squares, double lag1_products, int count) {
  if (count < 2 || sum_of_squares <= 0) return 0;
  const double correlation = std::clamp(lag1_products / sum_of_squares, 0.0, max_correlation);
  // Its own relative standard error is 1 / sqrt(2 n). Two of these are added: too small a deviation raises false
  // alarms.
  return deviation(sum_of_squares, count) * (1 + 2 / std::sqrt(2.0 * count)) *
         std::sqrt((1 + correlation) / (1 - correlation));
}

}  // namespace

std::span<const StencilStep> stencil_steps(bool monocular_depth) {
  static constexpr StencilStep usual[] = {{}};
  static constexpr StencilStep monocular[] = {
      {.rotation_rad = 0.375 * radians_per_degree, .translation_m = 0.075},
      {.rotation_rad = 1 * radians_per_degree, .translation_m = 0.2},
  };
  if (monocular_depth) return monocular;
  return usual;
}

double Stencil::best_neighbour() const {
  double best = -std::numeric_limits<double>::infinity();
  for (const Width& width : widths) best = std::max({best, width.minus.maxCoeff(), width.plus.maxCoeff()});
  return best;
}

Stencil evaluate_stencil(const FeatureSet& frame, const RigidTransform& T_camera_lidar,
                         std::span<const StencilStep> steps, const Objective& objective) {
  Stencil stencil;
  stencil.current = score(frame, T_camera_lidar, objective).value;
  for (const StencilStep& step : steps) {
    Stencil::Width width{step};
    for (int axis = 0; axis < 6; ++axis) {
      const Vector6 delta = Vector6::Unit(axis) * step.of_axis(axis);
      width.minus[axis] = score(frame, T_camera_lidar * perturbation(-delta), objective).value;
      width.plus[axis] = score(frame, T_camera_lidar * perturbation(delta), objective).value;
    }
    stencil.widths.push_back(width);
  }
  return stencil;
}

AxisEvidence axis_evidence(const Stencil& stencil, Timestamp stamp) {
  AxisEvidence evidence{.stamp = stamp, .score = stencil.current};
  const auto count = static_cast<double>(stencil.widths.size());
  for (const auto& [step, minus, plus] : stencil.widths) {
    for (int axis = 0; axis < 6; ++axis)
      evidence.slope[axis] += (plus[axis] - minus[axis]) / (2 * step.of_axis(axis)) / count;
    evidence.prominence += (stencil.current - (minus.sum() + plus.sum()) / 12) / count;
  }
  return evidence;
}

Matrix6 evaluate_sensitivity(const FeatureSet& frame, const RigidTransform& T_camera_lidar,
                             std::span<const StencilStep> steps, const Objective& objective) {
  const auto slope = [&](const Vector6& moved) {
    return axis_evidence(evaluate_stencil(frame, T_camera_lidar * perturbation(moved), steps, objective), {}).slope;
  };
  Matrix6 sensitivity;
  for (int axis = 0; axis < 6; ++axis) {
    // For the LiDAR's own data, a LiDAR that has moved forward is an extrinsic that lies behind it.
    const Vector6 shift = Vector6::Unit(axis) * sensitivity_shift.of_axis(axis);
    sensitivity.col(axis) = (slope(-shift) - slope(shift)) / (2 * sensitivity_shift.of_axis(axis));
  }
  // Saved with every pair, in half the space.
  return sensitivity.cast<float>().cast<double>();
}

void DriftBaseline::add(const AxisEvidence& evidence) {
  ++pairs;
  const Vector6 before = evidence.slope - slope;
  slope += before / pairs;
  const Vector6 away = evidence.slope - slope;
  slope_products += before * away.transpose();
  if (pairs > 1) lag1_products += away.cwiseProduct(latest_slope - slope);
  latest_slope = evidence.slope;
  if (evidence.sensitivity) {
    ++sensitivities;
    const Matrix6 sensitivity_before = *evidence.sensitivity - sensitivity;
    sensitivity += sensitivity_before / sensitivities;
    sensitivity_squares += sensitivity_before.diagonal().cwiseProduct((*evidence.sensitivity - sensitivity).diagonal());
  }
  const double prominence_before = evidence.prominence - prominence;
  prominence += prominence_before / pairs;
  prominence_squares += prominence_before * (evidence.prominence - prominence);
  if (pairs > 1) lag1_prominences += (evidence.prominence - prominence) * (latest_prominence - prominence);
  latest_prominence = evidence.prominence;
  const double score_before = evidence.score - score;
  score += score_before / pairs;
  score_squares += score_before * (evidence.score - score);
}

Vector6 DriftBaseline::distances(const DriftBaseline& batch) const {
  Vector6 distances = Vector6::Zero();
  if (pairs == 0 || batch.pairs == 0) return distances;
  for (int axis = 0; axis < 6; ++axis)
    if (const double error = spread(axis) * std::sqrt(1.0 / pairs + 1.0 / batch.pairs); error > 0)
      distances[axis] = (batch.slope[axis] - slope[axis]) / error;
  return distances;
}

void DriftBaseline::merge(const DriftBaseline& batch) {
  if (batch.pairs == 0) return;
  if (pairs == 0) {
    *this = batch;
    return;
  }
  const auto share = [](int mine, int others) { return static_cast<double>(others) / (mine + others); };
  const double of_batch = share(pairs, batch.pairs), products = pairs * of_batch;
  const Vector6 slope_away = batch.slope - slope;
  batches += batch.batches;
  batch_squares += batch.batch_squares;
  slope += of_batch * slope_away;
  slope_products += batch.slope_products + products * slope_away * slope_away.transpose();
  lag1_products += batch.lag1_products + products * slope_away.cwiseAbs2();
  latest_slope = batch.latest_slope;
  if (batch.sensitivities > 0) {
    const double of_these = share(sensitivities, batch.sensitivities);
    const Matrix6 away = batch.sensitivity - sensitivity;
    sensitivity += of_these * away;
    sensitivity_squares += batch.sensitivity_squares + sensitivities * of_these * away.diagonal().cwiseAbs2();
    sensitivities += batch.sensitivities;
  }
  const double prominence_away = batch.prominence - prominence;
  prominence += of_batch * prominence_away;
  prominence_squares += batch.prominence_squares + products * prominence_away * prominence_away;
  lag1_prominences += batch.lag1_prominences + products * prominence_away * prominence_away;
  latest_prominence = batch.latest_prominence;
  const double score_away = batch.score - score;
  score += of_batch * score_away;
  score_squares += batch.score_squares + products * score_away * score_away;
  pairs += batch.pairs;
}

double DriftBaseline::wander(int axis) const {
  // As if five batches had been independent: a few say little.
  return std::sqrt(std::max(1.0, (batch_squares[axis] + 5) / (batches + 5)));
}

double DriftBaseline::spread(int axis) const {
  return long_deviation(slope_products(axis, axis), lag1_products[axis], pairs);
}

double DriftBaseline::prominence_spread() const { return long_deviation(prominence_squares, lag1_prominences, pairs); }

bool DriftBaseline::observable(int axis) const {
  const double error = deviation(sensitivity_squares[axis], sensitivities) / std::sqrt(std::max(1, sensitivities));
  return sensitivities > 1 && spread(axis) > 0 && sensitivity(axis, axis) > observable_sigmas * error;
}

}  // namespace calib
