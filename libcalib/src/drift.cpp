#include "calib/drift.hpp"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>

namespace calib {
namespace {

/// Pairs that are remembered, and from which the present misalignment is estimated.
constexpr std::size_t estimate_pairs = 12;
constexpr int least_estimate_pairs = 3;
/// Pairs whose median counts.
constexpr std::size_t median_pairs = 3;
/// Pairs from which an extrinsic can be said to be wrong from the start, and how sure that must be.
constexpr int least_start_pairs = 6;
constexpr double start_sigmas = 4;
/// An axis is observable when its mean response is this many standard errors above zero.
constexpr double observable_sigmas = 3;
/// One median counts for no more than this many standard deviations.
constexpr double max_deviation = 4;
/// No median counts for more than this share of a limit; no sum does for more than that one.
constexpr double max_share = 0.4, max_sum_share = 1.2;
/// Shares of the limit at which there is a first sign, and a suspicion.
constexpr double first_sign_share = 0.25, suspect_share = 0.8;
/// Pairs within which a shift that is called noticeable is noticed.
constexpr double noticed_pairs = 100;
/// What is not sure of the baseline's mean, 1 / sqrt(pairs) deviations, is added to the reference this many times.
constexpr double mean_sigmas = 1.5;
/// Of consecutive pairs; what looks like more is a trend.
constexpr double max_correlation = 0.6;
/// An axis is said to have moved when its estimate is this sure.
constexpr double sure_sigmas = 2;
/// Variance of the median of many normal values, in that of their mean.
constexpr double median_variance = 1.57;

/// Half widths of the shifts that a response is measured with: those that must be told apart.
constexpr StencilStep response_shift{.rotation_rad = 0.25 * radians_per_degree, .translation_m = 0.1};

double deviation(double sum_of_squares, int count) { return count < 2 ? 0 : std::sqrt(sum_of_squares / (count - 1)); }

double median(double a, double b, double c) { return std::max(std::min(a, b), std::min(std::max(a, b), c)); }

double median(std::vector<double> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::ranges::nth_element(values, middle);
  if (values.size() % 2 == 1) return *middle;
  return (*middle + *std::max_element(values.begin(), middle)) / 2;
}

/// Slopes of the score along each axis.
Vector6 slopes(const FeatureSet& frame, const RigidTransform& T_camera_lidar, const StencilStep& step,
               const Objective& objective) {
  Vector6 slope;
  for (int axis = 0; axis < 6; ++axis) {
    const Vector6 delta = Vector6::Unit(axis) * step.of_axis(axis);
    slope[axis] = (score(frame, T_camera_lidar * perturbation(delta), objective).value -
                   score(frame, T_camera_lidar * perturbation(-delta), objective).value) /
                  (2 * step.of_axis(axis));
  }
  return slope;
}

/// How far beyond the bias of a depth source the optimum lies along an axis, in standard errors. Where there is no hill
/// at all, any significant slope counts: then the extrinsic is far off.
double start_misalignment(const DriftBaseline& seen, int axis, double max_bias) {
  const double slope_error = deviation(seen.slope_products(axis, axis), seen.pairs) / std::sqrt(seen.pairs);
  if (slope_error <= 0 || !std::isfinite(max_bias)) return 0;
  const double allowed = std::max(0.0, seen.response(axis, axis)) * max_bias;
  return (std::abs(seen.slope[axis]) - allowed) / slope_error;
}

/// "yaw: 0.62 degrees to the left, sigma 0.05": the motion of the LiDAR, as words.
std::string in_words(int axis, double delta, double sigma) {
  static constexpr const char* positive[] = {"right side down", "nose down",   "to the left",
                                             "forward",         "to the left", "up"};
  static constexpr const char* negative[] = {"left side down", "nose up",      "to the right",
                                             "back",           "to the right", "down"};
  const double unit = axis < 3 ? radians_per_degree : 0.01;
  char text[96];
  std::snprintf(text, sizeof text, "%s: %.*f %s %s, sigma %.*f", std::string(axis_names[axis]).c_str(),
                axis < 3 ? 2 : 1, std::abs(delta) / unit, axis < 3 ? "degrees" : "cm",
                delta >= 0 ? positive[axis] : negative[axis], axis < 3 ? 2 : 1, sigma / unit);
  return text;
}

}  // namespace

double Stencil::best_neighbour() const { return std::max(minus.maxCoeff(), plus.maxCoeff()); }

Stencil evaluate_stencil(const FeatureSet& frame, const RigidTransform& T_camera_lidar, const StencilStep& step,
                         const Objective& objective) {
  Stencil stencil;
  stencil.current = score(frame, T_camera_lidar, objective).value;
  for (int axis = 0; axis < 6; ++axis) {
    const Vector6 delta = Vector6::Unit(axis) * step.of_axis(axis);
    stencil.minus[axis] = score(frame, T_camera_lidar * perturbation(-delta), objective).value;
    stencil.plus[axis] = score(frame, T_camera_lidar * perturbation(delta), objective).value;
  }
  return stencil;
}

AxisEvidence axis_evidence(const Stencil& stencil, Timestamp stamp, const StencilStep& step) {
  AxisEvidence evidence{.stamp = stamp, .score = stencil.current};
  for (int axis = 0; axis < 6; ++axis)
    evidence.slope[axis] = (stencil.plus[axis] - stencil.minus[axis]) / (2 * step.of_axis(axis));
  return evidence;
}

Matrix6 evaluate_response(const FeatureSet& frame, const RigidTransform& T_camera_lidar, const StencilStep& step,
                          const Objective& objective) {
  Matrix6 response;
  for (int axis = 0; axis < 6; ++axis) {
    // Seen from its own data, a LiDAR that has moved forward is an extrinsic that has stayed behind.
    const Vector6 shift = Vector6::Unit(axis) * response_shift.of_axis(axis);
    response.col(axis) = (slopes(frame, T_camera_lidar * perturbation(-shift), step, objective) -
                          slopes(frame, T_camera_lidar * perturbation(shift), step, objective)) /
                         (2 * response_shift.of_axis(axis));
  }
  return response;
}

void DriftBaseline::add(const AxisEvidence& evidence) {
  ++pairs;
  const Vector6 before = evidence.slope - slope;
  slope += before / pairs;
  const Vector6 away = evidence.slope - slope;
  slope_products += before * away.transpose();
  if (pairs > 1) lagged_products += away.cwiseProduct(latest_slope - slope);
  latest_slope = evidence.slope;
  const Matrix6 response_before = *evidence.response - response;
  response += response_before / pairs;
  response_squares += response_before.diagonal().cwiseProduct((*evidence.response - response).diagonal());
  const double score_before = evidence.score - score;
  score += score_before / pairs;
  score_squares += score_before * (evidence.score - score);
}

double DriftBaseline::spread(int axis) const {
  if (pairs < 2 || slope_products(axis, axis) <= 0) return 0;
  const double correlation = std::clamp(lagged_products[axis] / slope_products(axis, axis), 0.0, max_correlation);
  // The deviation of n values is itself unsure by 1 / sqrt(2 n) of it: two of these more, for too small a one would
  // raise false alarms.
  return deviation(slope_products(axis, axis), pairs) * (1 + 2 / std::sqrt(2.0 * pairs)) *
         std::sqrt((1 + correlation) / (1 - correlation));
}

bool DriftBaseline::observable(int axis) const {
  const double error = deviation(response_squares[axis], pairs) / std::sqrt(std::max(1, pairs));
  return pairs > 1 && spread(axis) > 0 && response(axis, axis) > observable_sigmas * error;
}

double cusum_limit(double k, double false_alarms_per_pair) {
  // Average run length of one one-sided CUSUM of independent normal values: exp(2 k (h + 1.166)) / (2 k^2) (Siegmund
  // 1985, Eq. 2.56). There are 24 of them.
  const double run_length = 24 / false_alarms_per_pair;
  return std::log(2 * k * k * run_length) / (2 * k) - 1.166;
}

DriftMonitor::DriftMonitor(const DriftSettings& settings, DriftState state)
    : settings_(settings), state_(std::move(state)) {
  for (std::size_t i = 0; i < limits_.size(); ++i)
    limits_[i] = cusum_limit(cusum_references[i], settings_.false_alarms_per_pair);
}

void DriftMonitor::restart() { state_ = {}; }

double DriftMonitor::reference(std::size_t chart, int axis) const {
  const double negligible = axis < 3 ? settings_.negligible_rotation_rad : settings_.negligible_translation_m;
  const DriftBaseline& baseline = state_.baseline;
  return cusum_references[chart] + mean_sigmas / std::sqrt(baseline.pairs) +
         negligible * baseline.response(axis, axis) / baseline.spread(axis);
}

void DriftMonitor::accumulate() {
  if (state_.recent.size() < median_pairs) return;
  const DriftState::Seen* latest = state_.recent.data() + state_.recent.size() - median_pairs;
  for (int axis = 0; axis < 6; ++axis) {
    const DriftBaseline& baseline = state_.baseline;
    if (!baseline.observable(axis)) continue;
    const double slope = median(latest[0].slope[axis], latest[1].slope[axis], latest[2].slope[axis]);
    const double value =
        std::clamp((slope - baseline.slope[axis]) / baseline.spread(axis), -max_deviation, max_deviation);
    for (std::size_t side = 0; side < 2; ++side)
      for (std::size_t chart = 0; chart < limits_.size(); ++chart) {
        auto& [sum, since] = state_.charts[static_cast<std::size_t>(axis)][side][chart];
        if (sum <= 0) since = latest[1].stamp;
        const double more = (side == 0 ? value : -value) - reference(chart, axis);
        // Two bad pairs make two bad medians at most. Sums are capped, so that a long drift does not take for ever to
        // clear.
        sum = std::clamp(sum + std::min(more, max_share * limits_[chart]), 0.0, max_sum_share * limits_[chart]);
      }
  }
}

double DriftMonitor::evidence(int axis) const {
  double most = 0;
  for (const auto& side : state_.charts[static_cast<std::size_t>(axis)])
    for (std::size_t chart = 0; chart < limits_.size(); ++chart)
      most = std::max(most, side[chart].sum / limits_[chart]);
  return most;
}

double DriftMonitor::evidence() const {
  double most = 0;
  for (int axis = 0; axis < 6; ++axis) most = std::max(most, evidence(axis));
  return most;
}

/// One bad frame must not widen the spread so far that a drift after it is not seen.
bool DriftMonitor::is_usual(const AxisEvidence& evidence) const {
  for (int axis = 0; axis < 6; ++axis) {
    const double spread = state_.baseline.spread(axis);
    if (spread > 0 && std::abs(evidence.slope[axis] - state_.baseline.slope[axis]) > max_deviation * spread)
      return false;
  }
  return true;
}

DriftVerdict DriftMonitor::decide() const {
  const DriftVerdict before = verdict();
  const double now = evidence();
  if (now >= 1) return DriftVerdict::drifted;
  // Hysteresis: what was drifted stays so, and what was suspect stays so, until little evidence is left.
  if (now >= first_sign_share && (before == DriftVerdict::drifted || before == DriftVerdict::suspect)) return before;
  if (now >= suspect_share) return DriftVerdict::suspect;
  for (int axis = 0; axis < 3; ++axis)
    if (noticeable_shift(axis) > settings_.must_notice_rotation_rad) return DriftVerdict::blind;
  return DriftVerdict::calibrated;
}

/// The verdict while the baseline is not known yet.
DriftVerdict DriftMonitor::decide_from_start() const {
  const DriftBaseline& seen = state_.baseline;
  if (seen.pairs < least_start_pairs) return verdict();
  double sigmas = 0;
  for (int axis = 0; axis < 6; ++axis)
    sigmas = std::max(
        sigmas,
        start_misalignment(seen, axis, axis < 3 ? settings_.max_bias_rotation_rad : settings_.max_bias_translation_m));
  const DriftVerdict now = sigmas >= start_sigmas       ? DriftVerdict::drifted
                           : sigmas >= start_sigmas / 2 ? DriftVerdict::suspect
                                                        : DriftVerdict::learning;
  // What was said is taken back by as many pairs as make a baseline, not by the first few.
  return learned() ? now : std::max(now, verdict());
}

DriftVerdict DriftMonitor::observe(const AxisEvidence& evidence) {
  state_.recent.push_back({evidence.stamp, evidence.slope});
  if (state_.recent.size() > estimate_pairs) state_.recent.erase(state_.recent.begin());
  if (learned()) {
    accumulate();
    state_.verdict = decide();
    if (wants_response() && this->evidence() < first_sign_share && is_usual(evidence)) state_.baseline.add(evidence);
    return verdict();
  }
  state_.baseline.add(evidence);
  state_.verdict = decide_from_start();
  if (!learned()) return verdict();
  if (state_.verdict == DriftVerdict::learning)
    state_.verdict = decide();
  else
    state_.baseline = {};  // nothing is learned from pairs that already speak of misalignment
  return verdict();
}

std::string DriftMonitor::reason() const {
  switch (verdict()) {
    case DriftVerdict::learning:
      return "learning the baseline: " + std::to_string(state_.baseline.pairs) + " of " +
             std::to_string(settings_.baseline_pairs) + " pairs";
    case DriftVerdict::blind:
      return "too unsure to tell: " + least_noticeable() + " could go unnoticed";
    case DriftVerdict::calibrated:
      return "the extrinsic is where it was when it was accepted";
    case DriftVerdict::suspect:
    case DriftVerdict::drifted:
      break;
  }
  if (!learned()) return "the extrinsic does not fit what the sensors see, from the start";
  return "the LiDAR seems to have moved" + moved_axes();
}

/// The rotation that is least likely to be noticed.
std::string DriftMonitor::least_noticeable() const {
  int least = 0;
  for (int axis = 1; axis < 3; ++axis)
    if (noticeable_shift(axis) > noticeable_shift(least)) least = axis;
  const double shift = noticeable_shift(least);
  char text[96];
  if (std::isfinite(shift))
    std::snprintf(text, sizeof text, "%.2f degrees of %s", shift / radians_per_degree, axis_names[least].data());
  else
    std::snprintf(text, sizeof text, "any %s", axis_names[least].data());
  return text;
}

/// The axes along which the LiDAR has surely moved; failing these, the one that speaks most of drift.
std::string DriftMonitor::moved_axes() const {
  const auto estimate = misalignment();
  if (!estimate) return "";
  const Vector6 sigma = estimate->sigma();
  std::string words;
  int loudest = 0;
  for (int axis = 0; axis < 6; ++axis) {
    if (evidence(axis) > evidence(loudest)) loudest = axis;
    if (std::abs(estimate->delta[axis]) > sure_sigmas * sigma[axis])
      words += (words.empty() ? ": " : "; ") + in_words(axis, estimate->delta[axis], sigma[axis]);
  }
  return words.empty() ? ": " + in_words(loudest, estimate->delta[loudest], sigma[loudest]) : words;
}

std::optional<DriftMonitor::Estimate> DriftMonitor::misalignment() const {
  if (!learned()) return std::nullopt;
  const DriftBaseline& baseline = state_.baseline;
  // Pairs from before the drift began would dilute the estimate.
  const Timestamp from = first_sign().value_or(Timestamp::min());
  std::array<std::vector<double>, 6> seen;
  for (const DriftState::Seen& pair : state_.recent)
    if (pair.stamp >= from)
      for (int axis = 0; axis < 6; ++axis) seen[static_cast<std::size_t>(axis)].push_back(pair.slope[axis]);
  const auto pairs = static_cast<int>(seen[0].size());
  if (pairs < least_estimate_pairs) return std::nullopt;

  // In units of one pair's spread (rows) and of the prior (columns).
  const StencilStep step;
  Vector6 away = Vector6::Zero(), weight = Vector6::Zero(), prior;
  Matrix6 response = Matrix6::Zero();
  for (int axis = 0; axis < 6; ++axis) {
    prior[axis] = step.of_axis(axis);
    if (baseline.spread(axis) > 0) weight[axis] = 1 / baseline.spread(axis);
    away[axis] = (median(seen[static_cast<std::size_t>(axis)]) - baseline.slope[axis]) * weight[axis];
    if (baseline.observable(axis)) response.col(axis) = baseline.response.col(axis) * prior[axis];
  }
  response = weight.asDiagonal() * response;
  const Matrix6 spread = weight.asDiagonal() * baseline.slope_products * weight.asDiagonal() / (baseline.pairs - 1);
  const Matrix6 noise = spread * (median_variance / pairs + 1.0 / baseline.pairs) + 1e-9 * Matrix6::Identity();
  const Eigen::LDLT<Matrix6> both(response * response.transpose() + noise);
  const Matrix6 gain = both.solve(response).transpose();
  Estimate estimate;
  estimate.delta = prior.cwiseProduct(gain * away).cwiseMax(-2 * prior).cwiseMin(2 * prior);
  estimate.covariance = prior.asDiagonal() * (Matrix6::Identity() - gain * response) * prior.asDiagonal();
  return estimate;
}

double DriftMonitor::noticeable_shift(int axis) const {
  const DriftBaseline& baseline = state_.baseline;
  if (!learned() || !baseline.observable(axis)) return std::numeric_limits<double>::infinity();
  double least = std::numeric_limits<double>::infinity();
  for (std::size_t chart = 0; chart < limits_.size(); ++chart)
    least = std::min(least, reference(chart, axis) + limits_[chart] / noticed_pairs);
  return least * baseline.spread(axis) / baseline.response(axis, axis);
}

std::optional<Timestamp> DriftMonitor::first_sign() const {
  if (verdict() != DriftVerdict::suspect && verdict() != DriftVerdict::drifted) return std::nullopt;
  if (!learned()) return Timestamp::min();
  // A patient sum reaches back into the chance of before; where a quick one speaks too, it knows better.
  std::optional<Timestamp> first;
  for (std::size_t chart = 0; chart < limits_.size() && !first; ++chart)
    for (const auto& axis : state_.charts)
      for (const auto& side : axis)
        if (side[chart].sum >= first_sign_share * limits_[chart] && (!first || side[chart].since < *first))
          first = side[chart].since;
  return first;
}

}  // namespace calib
