#include "baseline_record.hpp"

#include <algorithm>
#include <cmath>

namespace calib {

CalibrationRecord::Baseline recorded(const DriftBaseline& baseline) {
  const double others = std::max(1, baseline.pairs - 1);
  const Matrix6 covariance = baseline.slope_products / others;
  Vector6 correlation = Vector6::Zero();
  for (int axis = 0; axis < 6; ++axis)
    if (baseline.slope_products(axis, axis) > 0)
      correlation[axis] = baseline.lag1_products[axis] / baseline.slope_products(axis, axis);
  return {.pairs = static_cast<std::uint64_t>(baseline.pairs),
          .slope = baseline.slope,
          .slope_covariance = (covariance + covariance.transpose()) / 2,  // to the last bit
          .slope_correlation = correlation,
          .sensitivity = baseline.sensitivity,
          .sensitivity_deviation = (baseline.sensitivity_squares / std::max(1, baseline.sensitivities - 1)).cwiseSqrt(),
          .prominence = baseline.prominence,
          .prominence_deviation = std::sqrt(baseline.prominence_squares / others),
          .prominence_correlation =
              baseline.prominence_squares > 0 ? baseline.lag1_prominences / baseline.prominence_squares : 0,
          .score = baseline.score,
          .score_deviation = std::sqrt(baseline.score_squares / others)};
}

DriftState learned_state(const CalibrationRecord::Baseline& recorded) {
  const double others = static_cast<double>(recorded.pairs) - 1;
  // All that the record says of the sensitivities is their deviation: of as many pairs as it takes at least.
  const int sensitivities = std::min(static_cast<int>(recorded.pairs), DriftMonitor::enough_sensitivities);
  DriftState state;
  state.baseline = {
      .pairs = static_cast<int>(recorded.pairs),
      .sensitivities = sensitivities,
      .slope = recorded.slope,
      .slope_products = recorded.slope_covariance * others,
      .latest_slope = recorded.slope,
      .lag1_products = recorded.slope_correlation.cwiseProduct(recorded.slope_covariance.diagonal()) * others,
      .sensitivity = recorded.sensitivity,
      .sensitivity_squares = recorded.sensitivity_deviation.cwiseAbs2() * (sensitivities - 1),
      .prominence = recorded.prominence,
      .prominence_squares = recorded.prominence_deviation * recorded.prominence_deviation * others,
      .latest_prominence = recorded.prominence,
      .lag1_prominences =
          recorded.prominence_correlation * recorded.prominence_deviation * recorded.prominence_deviation * others,
      .score = recorded.score,
      .score_squares = recorded.score_deviation * recorded.score_deviation * others};
  state.verdict = DriftVerdict::calibrated;
  return state;
}

}  // namespace calib
