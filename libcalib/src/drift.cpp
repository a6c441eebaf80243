#include "calib/drift.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

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
/// No value counts for more than this many standard deviations.
constexpr double max_deviation = 4;
/// Shares of the limit from which a run of evidence counts, and from which there is a suspicion.
constexpr double evidence_share = 0.25, suspect_share = 0.8;
/// Reference values in standard deviations of one pair: a shift of twice as much is found quickest.
constexpr std::array<double, most_charts> own_references{1.5, 0.6, 0.3, 0.15, 0.075};
/// Always in use; further ones where they find anything in time. What these sum is long enough for roads to differ.
constexpr std::size_t quick_charts = 2;
/// The share of false alarms that the further ones may raise. It hardly changes their delay, and would that of the
/// others.
constexpr double slow_share = 0.2;
/// Sequences: 6 axes, 2 directions and the loss of the maximum.
constexpr int sequences = 13;
/// A scene that lasts for so many pairs counts once more, so that a road that always looks the same is watched.
constexpr int longest_repeats = 30;
/// Batches of the baseline hold the one share of its pairs, up to the other share of those within which a shift must be
/// detected: a detection has evidence after a quarter of its time, and that ends the learning.
constexpr double own_share = 0.25, batch_share = 0.25;
/// Batches whose mean is so many standard errors from that of the baseline, as roads let it wander, wait until further
/// ones have brought it back.
constexpr double doubtful_sigmas = 2;
/// Hysteresis: the share of `must_detect_rotation_rad` and of the pairs below which `insufficient_power` ends.
constexpr double clear_share = 0.8;
/// The reference values are raised by this many standard errors of the baseline's mean, each 1 / sqrt(pairs)
/// deviations.
constexpr double mean_sigmas = 1.5;
/// An axis that was found to have moved by fewer standard deviations is not named.
constexpr double shown_sigmas = 2;

double median(double a, double b, double c) { return std::max(std::min(a, b), std::min(std::max(a, b), c)); }

/// How far beyond the bias of a depth source the optimum lies along an axis, in standard errors. Where there is no
/// maximum nearby any significant slope counts: then the extrinsic is far off.
double start_misalignment(const DriftBaseline& seen, int axis, double max_bias) {
  const double slope_error = seen.spread(axis) / std::sqrt(seen.pairs);
  if (slope_error <= 0 || !std::isfinite(max_bias)) return 0;
  const double allowed = std::max(0.0, seen.sensitivity(axis, axis)) * max_bias;
  return (std::abs(seen.slope[axis]) - allowed) / slope_error;
}

}  // namespace

DriftSettings usual_drift_settings(bool monocular_depth) {
  if (!monocular_depth) return {};
  // Such depth errs alike wherever a road looks alike.
  return {.baseline_pairs = 120,
          .min_scene_change = 0.55,
          .max_bias_rotation_rad = radians_per_degree,
          .max_bias_translation_m = std::numeric_limits<double>::infinity()};
}

DriftMonitor::DriftMonitor(const DriftSettings& settings, DriftState state)
    : settings_(settings), state_(std::move(state)) {
  // A verdict stands on the baseline that it was made with, also where the settings ask for another one since. Pairs
  // that are not learned have come after a baseline; a verdict of drift without them is one from the start.
  if (state_.verdict == DriftVerdict::calibrated || state_.verdict == DriftVerdict::insufficient_power ||
      state_.unlearned > 0)
    settings_.baseline_pairs = std::min(settings_.baseline_pairs, std::max(2, state_.baseline.pairs));
  else if (speaks_of_drift(state_.verdict))
    settings_.baseline_pairs = std::max(settings_.baseline_pairs, state_.baseline.pairs + 1);
  const auto limit = [&](std::size_t chart, std::size_t charts, double share_of_alarms) {
    return cusum_limit(own_references[chart],
                       static_cast<double>(sequences * charts) / (share_of_alarms * settings_.false_alarms_per_pair));
  };
  for (std::size_t chart = 0; chart < quick_charts; ++chart)
    limits_.push_back(limit(chart, quick_charts, 1 - slow_share));
  // A shift of twice a chart's reference value takes its limit over its reference value: some find nothing in time.
  // What a verdict of drift may stand on stays in use, also where there is less time since.
  std::size_t needed = 0;
  for (const auto& [positive, negative] : state_.charts)
    for (std::size_t chart = 0; speaks_of_drift(state_.verdict) && chart < most_charts; ++chart)
      if (positive[chart].sum > 0 || negative[chart].sum > 0) needed = std::max(needed, chart + 1);
  constexpr std::size_t most_slow = most_charts - quick_charts;
  for (std::size_t chart = quick_charts; chart < most_charts; ++chart)
    if (const double slow = limit(chart, most_slow, slow_share);
        slow / own_references[chart] <= settings_.pairs_to_detect || chart < needed)
      limits_.push_back(slow);
  // What is not in use now may be again, long after.
  for (auto& [positive, negative] : state_.charts)
    for (Charts* charts : {&positive, &negative})
      std::fill(charts->begin() + static_cast<std::ptrdiff_t>(limits_.size()), charts->end(), Cusum{});
}

void DriftMonitor::restart() { state_ = {}; }

double DriftMonitor::negligible(int axis) const {
  const DriftBaseline& baseline = state_.baseline;
  return (axis < 3 ? settings_.negligible_rotation_rad : settings_.negligible_translation_m) *
         baseline.sensitivity(axis, axis) / baseline.spread(axis);
}

double DriftMonitor::mean_error() const { return mean_sigmas / std::sqrt(state_.baseline.pairs); }

double DriftMonitor::reference(std::size_t chart) const { return own_references[chart] + mean_error(); }

/// Half-way between the prominence of the baseline and none, so that scenes of less prominence are not taken for a
/// displacement.
double DriftMonitor::loss_reference(std::size_t chart) const {
  return std::max(reference(chart), state_.baseline.prominence / state_.baseline.prominence_spread() / 2);
}

void DriftMonitor::accumulate() {
  if (state_.recent.size() < median_pairs) return;
  const DriftBaseline& baseline = state_.baseline;
  const auto latest = state_.recent.end() - median_pairs;
  // A quick chart takes medians, so that a single outlier has no effect. In the long sums of the others it has little,
  // whereas the median of a skew distribution is not its mean.
  const auto taken = [&](std::size_t chart, auto of) {
    return chart < quick_charts ? median(of(latest[0]), of(latest[1]), of(latest[2])) : of(latest[2]);
  };
  const auto update = [&](Charts& charts, std::size_t chart, double value) {
    charts[chart].update(value, latest[chart < quick_charts ? 1 : 2].stamp, limits_[chart]);
    // Once a quicker chart gives an alarm the slower ones are not needed, and would still give theirs long after the
    // shift was put right.
    if (charts[chart].share(limits_[chart]) >= 1)
      std::fill(charts.begin() + static_cast<std::ptrdiff_t>(chart) + 1, charts.end(), Cusum{});
  };
  for (int axis = 0; axis < 6; ++axis) {
    if (!baseline.observable(axis)) continue;
    auto& [positive, negative] = state_.charts[static_cast<std::size_t>(axis)];
    for (std::size_t chart = limits_.size(); chart-- > 0;) {
      const double slope = taken(chart, [&](const AxisEvidence& evidence) { return evidence.slope[axis]; });
      const double away = (slope - baseline.slope[axis]) / baseline.spread(axis);
      const auto shift = [&](double to_side) {
        return std::min(to_side - negligible(axis), max_deviation) / wander(axis, chart) - reference(chart);
      };
      update(positive, chart, shift(away));
      update(negative, chart, shift(-away));
    }
  }
  if (baseline.prominence_spread() <= 0) return;
  for (std::size_t chart = quick_charts; chart-- > 0;) {
    const double prominence = taken(chart, [](const AxisEvidence& evidence) { return evidence.prominence; });
    const double lost = (baseline.prominence - prominence) / baseline.prominence_spread();
    update(state_.loss_charts, chart, std::min(lost - loss_reference(chart), max_deviation));
  }
}

double DriftMonitor::wander(int axis, std::size_t chart) const {
  return chart < quick_charts ? 1 : state_.baseline.wander(axis);
}

double DriftMonitor::share(const Charts& charts) const {
  double most = 0;
  for (std::size_t chart = 0; chart < limits_.size(); ++chart)
    most = std::max(most, charts[chart].share(limits_[chart]));
  return most;
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
  for (std::size_t chart = 0; chart < quick_charts; ++chart)
    if ((lost - loss_reference(chart)) * pairs > limits_[chart]) return true;
  return false;
}

DriftVerdict DriftMonitor::decide() const {
  const DriftVerdict before = verdict();
  const double now = evidence();
  if (now >= 1) return DriftVerdict::drifted;
  // Hysteresis: what was drifted stays so, and what was suspect stays so, until little evidence is left.
  if (now >= evidence_share && speaks_of_drift(before)) return before;
  if (now >= suspect_share) return DriftVerdict::suspect;
  // Hysteresis here too: it takes a clear margin to call the detection power sufficient again.
  const double share = before == DriftVerdict::calibrated ? 1 : clear_share;
  if (!detects_lost_maximum(share * settings_.pairs_to_detect)) return DriftVerdict::insufficient_power;
  for (int axis = 0; axis < 3; ++axis)
    if (detection_limit(axis) > share * settings_.must_detect_rotation_rad) return DriftVerdict::insufficient_power;
  return DriftVerdict::calibrated;
}

/// The verdict while there is no baseline.
DriftVerdict DriftMonitor::decide_from_start() const {
  const DriftBaseline& seen = state_.baseline;
  const DriftVerdict before = speaks_of_drift(verdict()) ? verdict() : DriftVerdict::learning;
  if (seen.pairs < least_start_pairs) return before;
  double sigmas = 0;
  for (int axis = 0; axis < 6; ++axis)
    sigmas = std::max(
        sigmas,
        start_misalignment(seen, axis, axis < 3 ? settings_.max_bias_rotation_rad : settings_.max_bias_translation_m));
  const DriftVerdict now = sigmas >= start_sigmas       ? DriftVerdict::drifted
                           : sigmas >= start_sigmas / 2 ? DriftVerdict::suspect
                                                        : DriftVerdict::learning;
  // It takes as many pairs as a baseline to withdraw a verdict, not the first few.
  return learned() ? now : std::max(now, before);
}

bool DriftMonitor::wants_sensitivity() const {
  return learning() && state_.baseline.sensitivities < std::max(enough_sensitivities, settings_.baseline_pairs);
}

/// The oldest pair is forgotten. It is on its way into the baseline where nothing speaks of drift.
void DriftMonitor::retire_oldest() {
  const AxisEvidence oldest = std::move(state_.recent.front());
  const bool is_learned = state_.unlearned < static_cast<int>(state_.recent.size());
  state_.recent.pop_front();
  if (is_learned) return;
  --state_.unlearned;
  DriftBaseline& baseline = state_.baseline;
  if (!learning() || evidence() >= evidence_share || !is_outlier_free(oldest)) return;
  state_.gathered.add(oldest);
  if (state_.gathered.pairs < std::min(own_share * baseline.pairs, batch_share * settings_.pairs_to_detect)) return;
  const DriftBaseline batch = std::exchange(state_.waiting, std::exchange(state_.gathered, {}));
  if (batch.pairs == 0 || state_.doubtful.pairs >= settings_.max_baseline_pairs) return;
  // Roads may let it deviate, too: that is known from each batch.
  ++baseline.batches;
  baseline.batch_squares += baseline.distances(batch).cwiseAbs2();
  state_.doubtful.merge(batch);
  const Vector6 distances = baseline.distances(state_.doubtful);
  for (int axis = 0; axis < 6; ++axis)
    if (std::abs(distances[axis]) > doubtful_sigmas * baseline.wander(axis)) return;
  baseline.merge(std::exchange(state_.doubtful, {}));
}

Result<DriftVerdict> DriftMonitor::observe(const AxisEvidence& evidence) {
  if (evidence.same_scene && !state_.recent.empty() && (!learned() || ++state_.repeats < longest_repeats))
    return verdict();
  if (!learned() && !evidence.sensitivity)
    return fail(ErrorCode::sensitivity_missing, "a pair of the baseline needs the response of its slopes to shifts");
  state_.repeats = 0;
  while (state_.recent.size() >= recent_pairs) retire_oldest();
  state_.recent.push_back(evidence);
  if (learned()) {
    ++state_.unlearned;
    accumulate();
    state_.verdict = decide();
    // What was on its way into the baseline may be of after the onset.
    if (verdict() == DriftVerdict::drifted) state_.gathered = state_.waiting = state_.doubtful = {};
    return verdict();
  }
  state_.baseline.add(evidence);
  state_.verdict = decide_from_start();
  if (!learned()) return verdict();
  if (state_.verdict == DriftVerdict::learning)
    state_.verdict = decide();
  else
    state_.baseline = {};  // pairs with evidence of misalignment make no baseline
  return verdict();
}

std::string DriftMonitor::reason(const std::optional<Misalignment>& found) const {
  switch (verdict()) {
    case DriftVerdict::learning:
      return fmt::format("learning the baseline: {} of {} scenes", state_.baseline.pairs, settings_.baseline_pairs) +
             first_look();
    case DriftVerdict::insufficient_power:
      return "insufficient detection power: " + least_detectable() + " could go unnoticed";
    case DriftVerdict::calibrated:
      return "the extrinsic is where it was when it was accepted";
    case DriftVerdict::suspect:
    case DriftVerdict::drifted:
      break;
  }
  if (!learned()) return "the extrinsic does not fit what the sensors see, from the start";
  return "the LiDAR seems to have moved" + moved_axes(found);
}

/// How far from the extrinsic the optimum may lie, by the pairs so far: what a verdict from the start is made of, while
/// it is none.
std::string DriftMonitor::first_look() const {
  const DriftBaseline& seen = state_.baseline;
  if (seen.pairs < least_start_pairs) return "";
  Eigen::Vector3d farthest;
  for (int axis = 0; axis < 3; ++axis) {
    if (!seen.observable(axis)) return "";
    const double error = seen.spread(axis) / std::sqrt(seen.pairs);
    farthest[axis] = (std::abs(seen.slope[axis]) + 2 * error) / seen.sensitivity(axis, axis);
  }
  return fmt::format("; so far the best extrinsic is within {:.1f} degrees of it, which is no verdict",
                     std::ceil(10 * farthest.norm() / radians_per_degree) / 10);
}

/// The rotation with the largest detection limit, in words.
std::string DriftMonitor::least_detectable() const {
  if (!detects_lost_maximum(clear_share * settings_.pairs_to_detect))
    return "the extrinsic hardly scores better than its neighbours; even a large displacement";
  int least = 0;
  for (int axis = 1; axis < 3; ++axis)
    if (detection_limit(axis) > detection_limit(least)) least = axis;
  const double shift = detection_limit(least);
  return std::isfinite(shift) ? fmt::format("{:.2f} degrees of {}", shift / radians_per_degree, axis_names[least])
                              : fmt::format("any {}", axis_names[least]);
}

/// The axes along which the LiDAR has moved.
std::string DriftMonitor::moved_axes(const std::optional<Misalignment>& found) const {
  const auto estimate = found ? found : misalignment();
  const bool at_least = !found && maximum_is_lost();
  std::string words;
  for (int axis = 0; estimate && axis < 6; ++axis) {
    const double moved = estimate->delta[axis], sigma = estimate->sigma()[axis];
    if (found ? std::abs(moved) < shown_sigmas * sigma : moved == 0) continue;
    words += (words.empty() ? ": " : "; ") + std::string(axis_names[axis]) + " ";
    words += at_least ? motion_in_words(axis, moved) + " or more" : motion_in_words(axis, moved, sigma);
  }
  if (words.empty()) return at_least ? ", too far to estimate where to" : "; where to is not significant yet";
  return words;
}

double DriftMonitor::detection_limit(int axis) const {
  const DriftBaseline& baseline = state_.baseline;
  if (!learned() || !baseline.observable(axis)) return std::numeric_limits<double>::infinity();
  // The charts allow for a mean that errs to the side of the shift; it may err to the other side as well.
  double least = std::numeric_limits<double>::infinity();
  for (std::size_t chart = 0; chart < limits_.size(); ++chart)
    least = std::min(least, negligible(axis) + mean_error() +
                                wander(axis, chart) * (reference(chart) + limits_[chart] / settings_.pairs_to_detect));
  return least * baseline.spread(axis) / baseline.sensitivity(axis, axis);
}

double DriftMonitor::pairs_to_notice() const {
  const DriftBaseline& baseline = state_.baseline;
  double slowest = 0;
  for (int axis = 0; axis < 3; ++axis) {
    if (!(detection_limit(axis) <= settings_.must_detect_rotation_rad)) return std::numeric_limits<double>::infinity();
    const double shift = settings_.must_detect_rotation_rad * baseline.sensitivity(axis, axis) / baseline.spread(axis);
    const double seen = std::min(shift - negligible(axis) - mean_error(), max_deviation);
    double quickest = std::numeric_limits<double>::infinity();
    for (std::size_t chart = 0; chart < limits_.size(); ++chart)
      if (const double gain = seen / wander(axis, chart) - reference(chart); gain > 0) {
        const double at_once = Cusum::max_update_share * limits_[chart];
        const auto behind = static_cast<double>(chart < quick_charts ? median_pairs / 2 : 0);
        quickest = std::min(quickest, behind + std::ceil(limits_[chart] / std::min(gain, at_once)));
      }
    slowest = std::max(slowest, quickest);
  }
  return slowest;
}

std::optional<Timestamp> DriftMonitor::onset() const {
  if (!speaks_of_drift(verdict())) return std::nullopt;
  if (!learned()) return Timestamp::min();
  // The run of a slower chart may reach back into chance; where a quicker one has evidence too, its run is shorter.
  for (std::size_t chart = 0; chart < limits_.size(); ++chart) {
    std::optional<Timestamp> earliest;
    const auto consider = [&](const Cusum& cusum) {
      if (cusum.share(limits_[chart]) >= evidence_share && (!earliest || cusum.onset < *earliest))
        earliest = cusum.onset;
    };
    consider(state_.loss_charts[chart]);
    for (const auto& [positive, negative] : state_.charts) consider(positive[chart]), consider(negative[chart]);
    if (earliest) return earliest;
  }
  return std::nullopt;
}

}  // namespace calib
