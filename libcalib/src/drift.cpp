#include "calib/drift.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>

#include "calib/axis_words.hpp"

namespace calib {
namespace {

/// Pairs that are remembered: so long a pair waits, once there is a baseline, before it may be part of it. What is not
/// noticed by then is no shift.
constexpr std::size_t recent_pairs = 24;
/// Pairs whose median counts.
constexpr std::size_t median_pairs = 3;
/// Pairs from which an extrinsic can be said to be wrong from the start, and how sure that must be.
constexpr int least_start_pairs = 6;
constexpr double start_sigmas = 4;
/// One median counts for no more than this many standard deviations.
constexpr double max_deviation = 4;
/// No median counts for more than this share of a limit; no sum does for more than that one.
constexpr double max_share = 0.36, max_sum_share = 1.2;
/// Shares of the limit at which there is a first sign, and a suspicion.
constexpr double first_sign_share = 0.25, suspect_share = 0.8;
/// Pairs within which a shift that is called noticeable is noticed.
constexpr double noticed_pairs = 50;
/// What must be noticed within these, and how much of it, to come out of blindness.
constexpr double clear_share = 0.8;
/// What is not sure of the baseline's mean, 1 / sqrt(pairs) deviations, is added to the reference this many times.
constexpr double mean_sigmas = 1.5;

double median(double a, double b, double c) { return std::max(std::min(a, b), std::min(std::max(a, b), c)); }

/// How far beyond the bias of a depth source the optimum lies along an axis, in standard errors. Where there is no hill
/// at all, any significant slope counts: then the extrinsic is far off.
double start_misalignment(const DriftBaseline& seen, int axis, double max_bias) {
  const double slope_error = std::sqrt(seen.slope_products(axis, axis) / (seen.pairs - 1) / seen.pairs);
  if (slope_error <= 0 || !std::isfinite(max_bias)) return 0;
  const double allowed = std::max(0.0, seen.response(axis, axis)) * max_bias;
  return (std::abs(seen.slope[axis]) - allowed) / slope_error;
}

}  // namespace

DriftSettings usual_drift_settings(bool depth_is_guessed) {
  if (!depth_is_guessed) return {};
  return {.max_bias_rotation_rad = radians_per_degree,
          .max_bias_translation_m = std::numeric_limits<double>::infinity()};
}

double cusum_limit(double k, double false_alarms_per_pair) {
  // Average run length of one one-sided CUSUM of independent normal values: exp(2 k (h + 1.166)) / (2 k^2) (Siegmund
  // 1985, Eq. 2.56). There are 26 of them.
  const double run_length = 26 / false_alarms_per_pair;
  return std::log(2 * k * k * run_length) / (2 * k) - 1.166;
}

DriftMonitor::DriftMonitor(const DriftSettings& settings, DriftState state)
    : settings_(settings), state_(std::move(state)) {
  for (std::size_t i = 0; i < limits_.size(); ++i)
    limits_[i] = cusum_limit(cusum_references[i], settings_.false_alarms_per_pair);
}

void DriftMonitor::restart() { state_ = {}; }

double DriftMonitor::negligible(int axis) const {
  const DriftBaseline& baseline = state_.baseline;
  return (axis < 3 ? settings_.negligible_rotation_rad : settings_.negligible_translation_m) *
         baseline.response(axis, axis) / baseline.spread(axis);
}

double DriftMonitor::reference(std::size_t chart) const {
  return cusum_references[chart] + mean_sigmas / std::sqrt(state_.baseline.pairs);
}

/// Half-way between the peak as it was and none, so that scenery of flatter hills is not taken for a knock.
double DriftMonitor::peak_reference(std::size_t chart) const {
  const DriftBaseline& baseline = state_.baseline;
  return std::max(reference(chart), baseline.peak / baseline.peak_spread() / 2);
}

void DriftMonitor::accumulate() {
  if (state_.recent.size() < median_pairs) return;
  const DriftBaseline& baseline = state_.baseline;
  const auto latest = state_.recent.end() - median_pairs;
  const auto add = [&](DriftState::Chart& chart, double more, double limit) {
    if (chart.sum <= 0) chart.since = latest[1].stamp;
    // Two bad pairs make two bad medians at most. Sums are capped, so that a long drift does not take for ever to
    // clear.
    chart.sum = std::clamp(chart.sum + std::min(more, max_share * limit), 0.0, max_sum_share * limit);
  };
  for (int axis = 0; axis < 6; ++axis) {
    if (!baseline.observable(axis)) continue;
    const double slope = median(latest[0].slope[axis], latest[1].slope[axis], latest[2].slope[axis]);
    const double away = (slope - baseline.slope[axis]) / baseline.spread(axis);
    for (std::size_t side = 0; side < 2; ++side)
      for (std::size_t chart = 0; chart < limits_.size(); ++chart) {
        const double value = std::min((side == 0 ? away : -away) - negligible(axis), max_deviation);
        add(state_.charts[static_cast<std::size_t>(axis)][side][chart], value - reference(chart), limits_[chart]);
      }
  }
  if (baseline.peak_spread() <= 0) return;
  const double lost = (baseline.peak - median(latest[0].peak, latest[1].peak, latest[2].peak)) / baseline.peak_spread();
  for (std::size_t chart = 0; chart < limits_.size(); ++chart)
    add(state_.peak_charts[chart], lost - peak_reference(chart), limits_[chart]);
}

double DriftMonitor::evidence(int axis) const {
  double most = 0;
  for (const auto& side : state_.charts[static_cast<std::size_t>(axis)])
    for (std::size_t chart = 0; chart < limits_.size(); ++chart)
      most = std::max(most, side[chart].sum / limits_[chart]);
  return most;
}

double DriftMonitor::peak_evidence() const {
  double most = 0;
  for (std::size_t chart = 0; chart < limits_.size(); ++chart)
    most = std::max(most, state_.peak_charts[chart].sum / limits_[chart]);
  return most;
}

bool DriftMonitor::beyond_hill() const { return peak_evidence() >= first_sign_share; }

double DriftMonitor::evidence() const {
  double most = peak_evidence();
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
  return std::abs(evidence.peak - state_.baseline.peak) <= max_deviation * state_.baseline.peak_spread();
}

bool DriftMonitor::notices_lost_peak(double pairs) const {
  const DriftBaseline& baseline = state_.baseline;
  bool notices = false;
  for (std::size_t chart = 0; chart < limits_.size() && baseline.peak_spread() > 0; ++chart)
    notices = notices || (baseline.peak / baseline.peak_spread() - peak_reference(chart)) * pairs > limits_[chart];
  return notices;
}

DriftVerdict DriftMonitor::decide() const {
  const DriftVerdict before = verdict();
  const double now = evidence();
  if (now >= 1) return DriftVerdict::drifted;
  // Hysteresis: what was drifted stays so, and what was suspect stays so, until little evidence is left.
  if (now >= first_sign_share && (before == DriftVerdict::drifted || before == DriftVerdict::suspect)) return before;
  if (now >= suspect_share) return DriftVerdict::suspect;
  // Whoever was blind must see clearly before that is taken back.
  const double share = before == DriftVerdict::calibrated ? 1 : clear_share;
  if (!notices_lost_peak(share * noticed_pairs)) return DriftVerdict::blind;
  for (int axis = 0; axis < 3; ++axis)
    if (noticeable_shift(axis) > share * settings_.must_notice_rotation_rad) return DriftVerdict::blind;
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
  state_.recent.push_back(evidence);
  if (learned()) {
    accumulate();
    state_.verdict = decide();
    if (state_.recent.size() > recent_pairs) {
      const AxisEvidence& oldest = state_.recent.front();
      if (wants_response() && oldest.response && this->evidence() < first_sign_share && is_usual(oldest))
        state_.baseline.add(oldest);
      state_.recent.pop_front();
    }
    return verdict();
  }
  state_.baseline.add(evidence);
  state_.recent.back().response.reset();
  if (state_.recent.size() > recent_pairs) state_.recent.pop_front();
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
  if (!notices_lost_peak(clear_share * noticed_pairs))
    return "the extrinsic hardly scores better than its neighbours, so that even a large knock";
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

/// The axes along which the LiDAR has moved.
std::string DriftMonitor::moved_axes() const {
  const auto estimate = misalignment();
  std::string words;
  for (int axis = 0; estimate && axis < 6; ++axis) {
    if (estimate->delta[axis] == 0) continue;
    words += (words.empty() ? ": " : "; ") + std::string(axis_names[axis]) + " ";
    words += beyond_hill() ? motion_in_words(axis, estimate->delta[axis]) + " or more"
                           : motion_in_words(axis, estimate->delta[axis], estimate->sigma()[axis]);
  }
  if (words.empty()) return beyond_hill() ? ", too far to tell where to" : ", where to is not sure yet";
  return words;
}

double DriftMonitor::noticeable_shift(int axis) const {
  const DriftBaseline& baseline = state_.baseline;
  if (!learned() || !baseline.observable(axis)) return std::numeric_limits<double>::infinity();
  double least = std::numeric_limits<double>::infinity();
  for (std::size_t chart = 0; chart < limits_.size(); ++chart)
    least = std::min(least, negligible(axis) + reference(chart) + limits_[chart] / noticed_pairs);
  return least * baseline.spread(axis) / baseline.response(axis, axis);
}

std::optional<Timestamp> DriftMonitor::first_sign() const {
  if (verdict() != DriftVerdict::suspect && verdict() != DriftVerdict::drifted) return std::nullopt;
  if (!learned()) return Timestamp::min();
  // A patient sum reaches back into the chance of before; where a quick one speaks too, it knows better.
  std::optional<Timestamp> first;
  for (std::size_t chart = 0; chart < limits_.size() && !first; ++chart) {
    const auto consider = [&](const DriftState::Chart& speaks) {
      if (speaks.sum >= first_sign_share * limits_[chart] && (!first || speaks.since < *first)) first = speaks.since;
    };
    consider(state_.peak_charts[chart]);
    for (const auto& axis : state_.charts)
      for (const auto& side : axis) consider(side[chart]);
  }
  return first;
}

}  // namespace calib
