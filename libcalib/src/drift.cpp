#include "calib/drift.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "calib/axis_words.hpp"

namespace calib {
namespace {

/// Pairs that are remembered. Once there is a baseline, a pair enters it only after so many further pairs without
/// evidence of drift.
constexpr std::size_t recent_pairs = 24;
/// Pairs whose median counts.
constexpr std::size_t median_pairs = 3;
/// Pairs needed to call an extrinsic wrong from the start, and the significance that this takes.
constexpr int least_start_pairs = 6;
constexpr double start_sigmas = 4;
/// A median is clipped to this many standard deviations.
constexpr double max_deviation = 4;
/// Shares of the limit from which a run of evidence counts, and from which there is a suspicion.
constexpr double evidence_share = 0.25, suspect_share = 0.8;
/// Reference values in standard deviations of one pair: a shift of twice as much is found quickest.
constexpr PerChart<double> own_references{.rapid = 1.5, .sensitive = 0.6};
/// 6 axes, 2 directions and the loss of the maximum, 2 charts each.
constexpr int chart_count = 26;
/// Pairs within which a shift of the size of the detection limit is detected.
constexpr double detection_pairs = 50;
/// Hysteresis: the share of `must_detect_rotation_rad` and of these pairs below which `insufficient_power` ends.
constexpr double clear_share = 0.8;
/// The reference values are raised by this many standard errors of the baseline's mean, each 1 / sqrt(pairs)
/// deviations.
constexpr double mean_sigmas = 1.5;

double median(double a, double b, double c) { return std::max(std::min(a, b), std::min(std::max(a, b), c)); }

/// How far beyond the bias of a depth source the optimum lies along an axis, in standard errors. Where there is no
/// maximum nearby any significant slope counts: then the extrinsic is far off.
double start_misalignment(const DriftBaseline& seen, int axis, double max_bias) {
  const double slope_error = std::sqrt(seen.slope_products(axis, axis) / (seen.pairs - 1) / seen.pairs);
  if (slope_error <= 0 || !std::isfinite(max_bias)) return 0;
  const double allowed = std::max(0.0, seen.sensitivity(axis, axis)) * max_bias;
  return (std::abs(seen.slope[axis]) - allowed) / slope_error;
}

}  // namespace

DriftSettings usual_drift_settings(bool monocular_depth) {
  if (!monocular_depth) return {};
  return {.max_bias_rotation_rad = radians_per_degree,
          .max_bias_translation_m = std::numeric_limits<double>::infinity()};
}

DriftMonitor::DriftMonitor(const DriftSettings& settings, DriftState state)
    : settings_(settings), state_(std::move(state)) {
  const double run_length = chart_count / settings_.false_alarms_per_pair;
  limits_ = {cusum_limit(own_references.rapid, run_length), cusum_limit(own_references.sensitive, run_length)};
}

void DriftMonitor::restart() { state_ = {}; }

double DriftMonitor::negligible(int axis) const {
  const DriftBaseline& baseline = state_.baseline;
  return (axis < 3 ? settings_.negligible_rotation_rad : settings_.negligible_translation_m) *
         baseline.sensitivity(axis, axis) / baseline.spread(axis);
}

PerChart<double> DriftMonitor::references() const {
  const double of_mean = mean_sigmas / std::sqrt(state_.baseline.pairs);
  return {own_references.rapid + of_mean, own_references.sensitive + of_mean};
}

/// Half-way between the prominence of the baseline and none, so that scenes of less prominence are not taken for a
/// displacement.
PerChart<double> DriftMonitor::loss_references() const {
  const double half_lost = state_.baseline.prominence / state_.baseline.prominence_spread() / 2;
  const auto [rapid, sensitive] = references();
  return {std::max(rapid, half_lost), std::max(sensitive, half_lost)};
}

void DriftMonitor::accumulate() {
  if (state_.recent.size() < median_pairs) return;
  const DriftBaseline& baseline = state_.baseline;
  const auto latest = state_.recent.end() - median_pairs;
  const auto update = [&](Charts& charts, double value, const PerChart<double>& reference) {
    charts.rapid.update(value - reference.rapid, latest[1].stamp, limits_.rapid);
    charts.sensitive.update(value - reference.sensitive, latest[1].stamp, limits_.sensitive);
  };
  for (int axis = 0; axis < 6; ++axis) {
    if (!baseline.observable(axis)) continue;
    const double slope = median(latest[0].slope[axis], latest[1].slope[axis], latest[2].slope[axis]);
    const double away = (slope - baseline.slope[axis]) / baseline.spread(axis);
    auto& [positive, negative] = state_.charts[static_cast<std::size_t>(axis)];
    update(positive, std::min(away - negligible(axis), max_deviation), references());
    update(negative, std::min(-away - negligible(axis), max_deviation), references());
  }
  if (baseline.prominence_spread() <= 0) return;
  const double lost = (baseline.prominence - median(latest[0].prominence, latest[1].prominence, latest[2].prominence)) /
                      baseline.prominence_spread();
  update(state_.loss_charts, lost, loss_references());
}

double DriftMonitor::share(const Charts& charts) const {
  return std::max(charts.rapid.share(limits_.rapid), charts.sensitive.share(limits_.sensitive));
}

double DriftMonitor::evidence(int axis) const {
  const auto& [positive, negative] = state_.charts[static_cast<std::size_t>(axis)];
  return std::max(share(positive), share(negative));
}

double DriftMonitor::loss_evidence() const { return share(state_.loss_charts); }

bool DriftMonitor::maximum_is_lost() const { return loss_evidence() >= evidence_share; }

double DriftMonitor::evidence() const {
  double most = loss_evidence();
  for (int axis = 0; axis < 6; ++axis) most = std::max(most, evidence(axis));
  return most;
}

/// An outlier must not widen the baseline's spread so far that a later drift goes undetected.
bool DriftMonitor::is_outlier_free(const AxisEvidence& evidence) const {
  for (int axis = 0; axis < 6; ++axis) {
    const double spread = state_.baseline.spread(axis);
    if (spread > 0 && std::abs(evidence.slope[axis] - state_.baseline.slope[axis]) > max_deviation * spread)
      return false;
  }
  return std::abs(evidence.prominence - state_.baseline.prominence) <=
         max_deviation * state_.baseline.prominence_spread();
}

bool DriftMonitor::detects_lost_maximum(double pairs) const {
  const DriftBaseline& baseline = state_.baseline;
  if (baseline.prominence_spread() <= 0) return false;
  const double lost = baseline.prominence / baseline.prominence_spread();
  const auto [rapid, sensitive] = loss_references();
  return (lost - rapid) * pairs > limits_.rapid || (lost - sensitive) * pairs > limits_.sensitive;
}

DriftVerdict DriftMonitor::decide() const {
  const DriftVerdict before = verdict();
  const double now = evidence();
  if (now >= 1) return DriftVerdict::drifted;
  // Hysteresis: what was drifted stays so, and what was suspect stays so, until little evidence is left.
  if (now >= evidence_share && (before == DriftVerdict::drifted || before == DriftVerdict::suspect)) return before;
  if (now >= suspect_share) return DriftVerdict::suspect;
  // Hysteresis here too: it takes a clear margin to call the detection power sufficient again.
  const double share = before == DriftVerdict::calibrated ? 1 : clear_share;
  if (!detects_lost_maximum(share * detection_pairs)) return DriftVerdict::insufficient_power;
  for (int axis = 0; axis < 3; ++axis)
    if (detection_limit(axis) > share * settings_.must_detect_rotation_rad) return DriftVerdict::insufficient_power;
  return DriftVerdict::calibrated;
}

/// The verdict while there is no baseline.
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
  // It takes as many pairs as a baseline to withdraw a verdict, not the first few.
  return learned() ? now : std::max(now, verdict());
}

Result<DriftVerdict> DriftMonitor::observe(const AxisEvidence& evidence) {
  if (!learned() && !evidence.sensitivity)
    return fail(ErrorCode::sensitivity_missing, "a pair of the baseline needs the response of its slopes to shifts");
  state_.recent.push_back(evidence);
  if (learned()) {
    accumulate();
    state_.verdict = decide();
    if (state_.recent.size() > recent_pairs) {
      const AxisEvidence& oldest = state_.recent.front();
      if (wants_sensitivity() && oldest.sensitivity && this->evidence() < evidence_share && is_outlier_free(oldest))
        state_.baseline.add(oldest);
      state_.recent.pop_front();
    }
    return verdict();
  }
  state_.baseline.add(evidence);
  state_.recent.back().sensitivity.reset();
  if (state_.recent.size() > recent_pairs) state_.recent.pop_front();
  state_.verdict = decide_from_start();
  if (!learned()) return verdict();
  if (state_.verdict == DriftVerdict::learning)
    state_.verdict = decide();
  else
    state_.baseline = {};  // pairs with evidence of misalignment make no baseline
  return verdict();
}

std::string DriftMonitor::reason() const {
  switch (verdict()) {
    case DriftVerdict::learning:
      return fmt::format("learning the baseline: {} of {} pairs", state_.baseline.pairs, settings_.baseline_pairs);
    case DriftVerdict::insufficient_power:
      return "insufficient detection power: " + least_detectable() + " could go unnoticed";
    case DriftVerdict::calibrated:
      return "the extrinsic is where it was when it was accepted";
    case DriftVerdict::suspect:
    case DriftVerdict::drifted:
      break;
  }
  if (!learned()) return "the extrinsic does not fit what the sensors see, from the start";
  return "the LiDAR seems to have moved" + moved_axes();
}

/// The rotation with the largest detection limit, in words.
std::string DriftMonitor::least_detectable() const {
  if (!detects_lost_maximum(clear_share * detection_pairs))
    return "the extrinsic hardly scores better than its neighbours; even a large displacement";
  int least = 0;
  for (int axis = 1; axis < 3; ++axis)
    if (detection_limit(axis) > detection_limit(least)) least = axis;
  const double shift = detection_limit(least);
  return std::isfinite(shift) ? fmt::format("{:.2f} degrees of {}", shift / radians_per_degree, axis_names[least])
                              : fmt::format("any {}", axis_names[least]);
}

/// The axes along which the LiDAR has moved.
std::string DriftMonitor::moved_axes() const {
  const auto estimate = misalignment();
  std::string words;
  for (int axis = 0; estimate && axis < 6; ++axis) {
    if (estimate->delta[axis] == 0) continue;
    words += (words.empty() ? ": " : "; ") + std::string(axis_names[axis]) + " ";
    words += maximum_is_lost() ? motion_in_words(axis, estimate->delta[axis]) + " or more"
                               : motion_in_words(axis, estimate->delta[axis], estimate->sigma()[axis]);
  }
  if (words.empty()) return maximum_is_lost() ? ", too far to estimate where to" : "; where to is not significant yet";
  return words;
}

double DriftMonitor::detection_limit(int axis) const {
  const DriftBaseline& baseline = state_.baseline;
  if (!learned() || !baseline.observable(axis)) return std::numeric_limits<double>::infinity();
  const auto [rapid, sensitive] = references();
  const double least = std::min(negligible(axis) + rapid + limits_.rapid / detection_pairs,
                                negligible(axis) + sensitive + limits_.sensitive / detection_pairs);
  return least * baseline.spread(axis) / baseline.sensitivity(axis, axis);
}

std::optional<Timestamp> DriftMonitor::onset() const {
  if (verdict() != DriftVerdict::suspect && verdict() != DriftVerdict::drifted) return std::nullopt;
  if (!learned()) return Timestamp::min();
  const auto earliest = [&](Cusum Charts::*chart, double limit) {
    std::optional<Timestamp> onset;
    const auto consider = [&](const Charts& charts) {
      const Cusum& cusum = charts.*chart;
      if (cusum.share(limit) >= evidence_share && (!onset || cusum.onset < *onset)) onset = cusum.onset;
    };
    consider(state_.loss_charts);
    for (const auto& [positive, negative] : state_.charts) consider(positive), consider(negative);
    return onset;
  };
  // The run of a sensitive chart may reach back into chance; where a rapid chart has evidence too, its run is shorter.
  if (const auto rapid = earliest(&Charts::rapid, limits_.rapid)) return rapid;
  return earliest(&Charts::sensitive, limits_.sensitive);
}

}  // namespace calib
