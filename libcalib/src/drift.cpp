#include "calib/drift.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>

namespace calib {
namespace {

/// Pairs that the present misalignment is estimated from.
constexpr std::size_t estimate_pairs = 10;
constexpr int least_estimate_pairs = 3;
/// Pairs from which an extrinsic can be said to be wrong from the start, and how sure that must be.
constexpr int least_start_pairs = 6;
constexpr double start_sigmas = 4;
/// An axis is observable when its mean curvature is this many standard errors below zero.
constexpr double observable_sigmas = 3;

double deviation(double sum_of_squares, int count) { return count < 2 ? 0 : std::sqrt(sum_of_squares / (count - 1)); }

/// How far beyond the bias of a depth source the optimum lies along an axis, in standard errors. Where there is no hill
/// at all, any significant slope counts: then the extrinsic is far off.
double start_misalignment(const DriftBaseline& seen, int axis, double max_bias) {
  const double slope_error = deviation(seen.slope_squares[axis], seen.pairs) / std::sqrt(seen.pairs);
  if (slope_error <= 0) return 0;
  if (!std::isfinite(max_bias)) return 0;
  const double allowed = std::max(0.0, -seen.curvature[axis]) * max_bias;
  return (std::abs(seen.slope[axis]) - allowed) / slope_error;
}

/// "yaw 0.62 degrees to the left": the motion of the LiDAR, as words.
std::string axis_in_words(int axis, double delta) {
  static constexpr const char* positive[] = {"right side down", "nose down",   "to the left",
                                             "forward",         "to the left", "up"};
  static constexpr const char* negative[] = {"left side down", "nose up",      "to the right",
                                             "back",           "to the right", "down"};
  const double shown = axis < 3 ? delta / radians_per_degree : delta * 100;
  char text[96];
  std::snprintf(text, sizeof text, "%s %.2f %s %s", std::string(axis_names[axis]).c_str(), std::abs(shown),
                axis < 3 ? "degrees" : "cm", delta >= 0 ? positive[axis] : negative[axis]);
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
  AxisEvidence evidence;
  evidence.stamp = stamp;
  evidence.score = stencil.current;
  for (int axis = 0; axis < 6; ++axis) {
    const double h = step.of_axis(axis);
    evidence.slope[axis] = (stencil.plus[axis] - stencil.minus[axis]) / (2 * h);
    evidence.curvature[axis] = (stencil.plus[axis] - 2 * stencil.current + stencil.minus[axis]) / (h * h);
  }
  return evidence;
}

void DriftBaseline::add(const AxisEvidence& evidence) {
  ++pairs;
  const auto update = [&](Vector6& mean, Vector6& squares, const Vector6& value) {
    const Vector6 before = value - mean;
    mean += before / pairs;
    squares += before.cwiseProduct(value - mean);
  };
  update(slope, slope_squares, evidence.slope);
  update(curvature, curvature_squares, evidence.curvature);
  score += (evidence.score - score) / pairs;
}

double DriftBaseline::spread(int axis) const {
  // The deviation of n values is itself unsure by 1 / sqrt(2 n); taken too small it would raise false alarms.
  return deviation(slope_squares[axis], pairs) * (1 + 1 / std::sqrt(2.0 * std::max(1, pairs)));
}

bool DriftBaseline::observable(int axis) const {
  const double error = deviation(curvature_squares[axis], pairs) / std::sqrt(std::max(1, pairs));
  return pairs > 1 && spread(axis) > 0 && curvature[axis] < -observable_sigmas * error;
}

DriftMonitor::DriftMonitor(const DriftSettings& settings, DriftState state)
    : settings_(settings), state_(std::move(state)) {}

void DriftMonitor::restart() { state_ = {}; }

void DriftMonitor::accumulate(const AxisEvidence& evidence) {
  const DriftBaseline& baseline = state_.baseline;
  const double k = settings_.cusum_k + 1.5 / std::sqrt(baseline.pairs);
  // Evidence is capped at twice the limit, so that a long drift does not take for ever to clear.
  const auto step = [&](double& sum, Timestamp& since, double value) {
    if (sum <= 0) since = evidence.stamp;
    sum = std::clamp(sum + value - k, 0.0, 2 * settings_.cusum_h);
  };
  for (int axis = 0; axis < 6; ++axis) {
    if (!baseline.observable(axis)) continue;
    const double deviation = std::clamp((evidence.slope[axis] - baseline.slope[axis]) / baseline.spread(axis),
                                        -settings_.max_deviation, settings_.max_deviation);
    step(state_.cusum_up[axis], state_.up_since[axis], deviation);
    step(state_.cusum_down[axis], state_.down_since[axis], -deviation);
  }
}

double DriftMonitor::evidence() const { return std::max(state_.cusum_up.maxCoeff(), state_.cusum_down.maxCoeff()); }

/// One bad frame must not widen the spread so far that a drift after it is not seen.
bool DriftMonitor::is_usual(const AxisEvidence& evidence) const {
  for (int axis = 0; axis < 6; ++axis) {
    const double spread = state_.baseline.spread(axis);
    if (spread > 0 && std::abs(evidence.slope[axis] - state_.baseline.slope[axis]) > settings_.max_deviation * spread)
      return false;
  }
  return true;
}

DriftVerdict DriftMonitor::decide() const {
  const DriftVerdict before = verdict();
  if (evidence() >= settings_.cusum_h) return DriftVerdict::drifted;
  // Hysteresis: what was drifted stays so, and what was suspect stays so, until little evidence is left.
  if (evidence() >= settings_.cusum_h / 4 && (before == DriftVerdict::drifted || before == DriftVerdict::suspect))
    return before;
  return evidence() >= settings_.cusum_h / 2 ? DriftVerdict::suspect : DriftVerdict::calibrated;
}

/// The verdict while the baseline is not known yet, from the evidence of `recent`.
DriftVerdict DriftMonitor::decide_from_start() const {
  DriftBaseline seen;
  for (const AxisEvidence& evidence : state_.recent) seen.add(evidence);
  if (seen.pairs < least_start_pairs) return verdict();
  double sigmas = 0;
  for (int axis = 0; axis < 6; ++axis)
    sigmas = std::max(
        sigmas,
        start_misalignment(seen, axis, axis < 3 ? settings_.max_bias_rotation_rad : settings_.max_bias_translation_m));
  return sigmas >= start_sigmas       ? DriftVerdict::drifted
         : sigmas >= start_sigmas / 2 ? DriftVerdict::suspect
                                      : DriftVerdict::learning;
}

DriftVerdict DriftMonitor::observe(const Stencil& stencil, Timestamp stamp, const StencilStep& step) {
  const AxisEvidence seen = axis_evidence(stencil, stamp, step);
  const auto kept = std::max<std::size_t>(static_cast<std::size_t>(settings_.baseline_pairs), estimate_pairs);
  state_.recent.push_back(seen);
  if (state_.recent.size() > kept) state_.recent.erase(state_.recent.begin());
  if (learned()) {
    accumulate(seen);
    state_.verdict = decide();
    if (evidence() < settings_.cusum_h / 4 && state_.baseline.pairs < settings_.max_baseline_pairs && is_usual(seen))
      state_.baseline.add(seen);
    return verdict();
  }
  state_.verdict = decide_from_start();
  // Nothing is learned from pairs that already speak of misalignment.
  if (state_.verdict == DriftVerdict::learning &&
      state_.recent.size() >= static_cast<std::size_t>(settings_.baseline_pairs)) {
    state_.baseline = {};
    for (const AxisEvidence& evidence : state_.recent) state_.baseline.add(evidence);
    state_.verdict = DriftVerdict::calibrated;
  }
  return verdict();
}

std::string DriftMonitor::reason() const {
  if (verdict() == DriftVerdict::learning)
    return "learning the baseline: " + std::to_string(state_.recent.size()) + " of " +
           std::to_string(settings_.baseline_pairs) + " pairs";
  if (verdict() == DriftVerdict::calibrated) return "the extrinsic is where it was when it was accepted";
  if (!learned()) return "the extrinsic does not fit what the sensors see, from the start";
  const auto estimate = misalignment();
  std::string words;
  for (int axis = 0; axis < 6; ++axis) {
    const double evidence = std::max(state_.cusum_up[axis], state_.cusum_down[axis]);
    if (evidence < settings_.cusum_h / 4 || !estimate) continue;
    words += (words.empty() ? "" : ", ") + axis_in_words(axis, estimate->delta[axis]);
  }
  return "the LiDAR seems to have moved" + (words.empty() ? "" : ": " + words);
}

std::optional<DriftMonitor::Estimate> DriftMonitor::misalignment() const {
  if (!learned()) return std::nullopt;
  // Pairs from before the drift began would dilute the estimate.
  const Timestamp from = first_sign().value_or(Timestamp::min());
  DriftBaseline seen;
  const std::size_t first = state_.recent.size() - std::min(state_.recent.size(), estimate_pairs);
  for (std::size_t i = first; i < state_.recent.size(); ++i)
    if (state_.recent[i].stamp >= from) seen.add(state_.recent[i]);
  if (seen.pairs < least_estimate_pairs) return std::nullopt;
  const DriftBaseline& baseline = state_.baseline;
  const StencilStep step;
  Estimate estimate{Vector6::Zero(), Vector6::Zero()};
  for (int axis = 0; axis < 6; ++axis) {
    const double limit = 2 * step.of_axis(axis);
    estimate.sigma[axis] = limit;
    if (!baseline.observable(axis)) continue;
    const double hill = -baseline.curvature[axis];
    estimate.delta[axis] = std::clamp((seen.slope[axis] - baseline.slope[axis]) / hill, -limit, limit);
    estimate.sigma[axis] = std::min(limit, baseline.spread(axis) / hill / std::sqrt(seen.pairs));
  }
  return estimate;
}

std::optional<Timestamp> DriftMonitor::first_sign() const {
  if (verdict() != DriftVerdict::suspect && verdict() != DriftVerdict::drifted) return std::nullopt;
  if (!learned()) return Timestamp::min();
  std::optional<Timestamp> first;
  const auto consider = [&](double evidence, Timestamp since) {
    if (evidence >= settings_.cusum_h / 4 && (!first || since < *first)) first = since;
  };
  for (int axis = 0; axis < 6; ++axis) {
    consider(state_.cusum_up[axis], state_.up_since[axis]);
    consider(state_.cusum_down[axis], state_.down_since[axis]);
  }
  return first;
}

}  // namespace calib
