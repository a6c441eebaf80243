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
      correlation[axis] = baseline.lagged_products[axis] / baseline.slope_products(axis, axis);
  return {.pairs = static_cast<std::uint64_t>(baseline.pairs),
          .slope = baseline.slope,
          .slope_covariance = (covariance + covariance.transpose()) / 2,  // to the last bit
          .slope_correlation = correlation,
          .response = baseline.response,
          .response_deviation = (baseline.response_squares / others).cwiseSqrt(),
          .peak = baseline.peak,
          .peak_deviation = std::sqrt(baseline.peak_squares / others),
          .peak_correlation = baseline.peak_squares > 0 ? baseline.lagged_peaks / baseline.peak_squares : 0,
          .score = baseline.score,
          .score_deviation = std::sqrt(baseline.score_squares / others)};
}

DriftState learned_state(const CalibrationRecord::Baseline& recorded) {
  const double others = static_cast<double>(recorded.pairs) - 1;
  DriftState state;
  state.baseline = {
      .pairs = static_cast<int>(recorded.pairs),
      .slope = recorded.slope,
      .slope_products = recorded.slope_covariance * others,
      .latest_slope = recorded.slope,
      .lagged_products = recorded.slope_correlation.cwiseProduct(recorded.slope_covariance.diagonal()) * others,
      .response = recorded.response,
      .response_squares = recorded.response_deviation.cwiseAbs2() * others,
      .peak = recorded.peak,
      .peak_squares = recorded.peak_deviation * recorded.peak_deviation * others,
      .latest_peak = recorded.peak,
      .lagged_peaks = recorded.peak_correlation * recorded.peak_deviation * recorded.peak_deviation * others,
      .score = recorded.score,
      .score_squares = recorded.score_deviation * recorded.score_deviation * others};
  state.verdict = DriftVerdict::calibrated;
  return state;
}

}  // namespace calib
