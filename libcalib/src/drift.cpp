#include "calib/drift.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>

namespace calib {
namespace {

constexpr std::size_t recent_pairs = 10;

/// Spread of one pair's offset where the vehicle's own is not known yet, and the least that is believed: KITTI with
/// depth from semi-global matching has the first, with a good stereo network half of it.
constexpr std::array<double, 6> typical_spread{0.25 * radians_per_degree, 0.12 * radians_per_degree,
                                               0.12 * radians_per_degree, 0.08, 0.04, 0.05};
constexpr double least_share_of_typical_spread = 0.4;

double median(std::vector<double> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::ranges::nth_element(values, middle);
  if (values.size() % 2 == 1) return *middle;
  return 0.5 * (*middle + *std::ranges::max_element(values.begin(), middle));
}

std::vector<double> along_axis(const std::vector<Vector6>& offsets, int axis) {
  std::vector<double> values;
  for (const Vector6& offset : offsets) values.push_back(offset[axis]);
  return values;
}

/// 1.4826 times the median absolute deviation: a standard deviation that a few bad frames do not move.
double robust_deviation(const std::vector<double>& values, double centre) {
  std::vector<double> deviations;
  for (double value : values) deviations.push_back(std::abs(value - centre));
  return 1.4826 * median(deviations);
}

/// "yaw 0.62 degrees to the left": the motion of the LiDAR, as words.
std::string axis_in_words(int axis, double delta) {
  static constexpr const char* positive[] = {"right side down", "nose down", "to the left", "forward", "to the left", "up"};
  static constexpr const char* negative[] = {"left side down", "nose up", "to the right", "back", "to the right", "down"};
  const double shown = axis < 3 ? delta / radians_per_degree : delta * 100;
  char text[96];
  std::snprintf(text, sizeof text, "%s %.2f %s %s", std::string(axis_names[axis]).c_str(), std::abs(shown),
                axis < 3 ? "degrees" : "cm", delta >= 0 ? positive[axis] : negative[axis]);
  return text;
}

}  // namespace

double Stencil::best_neighbour() const { return std::max(minus.maxCoeff(), plus.maxCoeff()); }

Stencil evaluate_stencil(const FeatureSet& frame, const RigidTransform& T_camera_lidar, const StencilStep& step) {
  Stencil stencil;
  stencil.current = score(frame, T_camera_lidar).value;
  for (int axis = 0; axis < 6; ++axis) {
    const Vector6 delta = Vector6::Unit(axis) * step.of_axis(axis);
    stencil.minus[axis] = score(frame, T_camera_lidar * perturbation(-delta)).value;
    stencil.plus[axis] = score(frame, T_camera_lidar * perturbation(delta)).value;
  }
  return stencil;
}

AxisOffsets axis_offsets(const Stencil& stencil, const StencilStep& step) {
  AxisOffsets offsets;
  for (int axis = 0; axis < 6; ++axis) {
    const double h = step.of_axis(axis);
    const double minus = stencil.minus[axis], plus = stencil.plus[axis];
    const double curvature = minus - 2 * stencil.current + plus;
    // Where the three values are not a hill, all that is known is which side is higher.
    const double vertex = curvature < 0 ? 0.5 * h * (minus - plus) / curvature : plus > minus ? h : -h;
    offsets.limited[axis] = std::abs(vertex) >= h;
    offsets.delta[axis] = std::clamp(vertex, -h, h);
  }
  return offsets;
}

DriftMonitor::DriftMonitor(const DriftSettings& settings, DriftState state)
    : settings_(settings), state_(std::move(state)) {}

void DriftMonitor::restart() { state_ = {}; }

Vector6 DriftMonitor::standardised(const AxisOffsets& offsets) const {
  Vector6 deviation;
  for (int axis = 0; axis < 6; ++axis) {
    const double bias = axis < 3 ? settings_.max_bias_rotation_rad : settings_.max_bias_translation_m;
    double excess = offsets.delta[axis], spread = typical_spread[axis];
    if (state_.baseline) {
      excess -= (*state_.baseline)[axis];
      spread = state_.spread[axis];
    } else if (offsets.limited[axis] && axis < 3) {
      excess = std::copysign(settings_.max_deviation * spread, excess);  // at least a step off: beyond any bias
    } else {
      excess = std::copysign(std::max(0.0, std::abs(excess) - bias), excess);
    }
    deviation[axis] = std::clamp(excess / spread, -settings_.max_deviation, settings_.max_deviation);
  }
  return deviation;
}

void DriftMonitor::accumulate(const Vector6& deviation, Timestamp stamp) {
  // Evidence is capped at twice the limit, so that a long drift does not take for ever to clear.
  const auto step = [&](double& sum, Timestamp& since, double value) {
    if (sum <= 0) since = stamp;
    sum = std::clamp(sum + value - settings_.cusum_k, 0.0, 2 * settings_.cusum_h);
  };
  for (int axis = 0; axis < 6; ++axis) {
    step(state_.cusum_up[axis], state_.up_since[axis], deviation[axis]);
    step(state_.cusum_down[axis], state_.down_since[axis], -deviation[axis]);
  }
}

void DriftMonitor::learn(const Vector6& delta, double score) {
  state_.learning.push_back(delta);
  state_.score_sum += score;
  if (state_.learning.size() < static_cast<std::size_t>(settings_.baseline_pairs)) return;
  Vector6 baseline;
  for (int axis = 0; axis < 6; ++axis) {
    const std::vector<double> values = along_axis(state_.learning, axis);
    const double centre = median(values);
    const double bias = axis < 3 ? settings_.max_bias_rotation_rad : settings_.max_bias_translation_m;
    baseline[axis] = std::clamp(centre, -bias, bias);
    state_.spread[axis] =
        std::max(robust_deviation(values, centre), least_share_of_typical_spread * typical_spread[axis]);
  }
  state_.baseline = baseline;
  state_.baseline_score = state_.score_sum / static_cast<double>(state_.learning.size());
  state_.learning.clear();
  state_.cusum_up.setZero();
  state_.cusum_down.setZero();
}

DriftVerdict DriftMonitor::decide() const {
  const double evidence = std::max(state_.cusum_up.maxCoeff(), state_.cusum_down.maxCoeff());
  const DriftVerdict before = verdict();
  if (evidence >= settings_.cusum_h) return DriftVerdict::drifted;
  // Hysteresis: what was drifted stays so, and what was suspect stays so, until little evidence is left.
  if (evidence >= settings_.cusum_h / 4 && (before == DriftVerdict::drifted || before == DriftVerdict::suspect))
    return before;
  if (evidence >= settings_.cusum_h / 2) return DriftVerdict::suspect;
  return state_.baseline ? DriftVerdict::calibrated : DriftVerdict::learning;
}

DriftVerdict DriftMonitor::observe(const Stencil& stencil, Timestamp stamp, const StencilStep& step) {
  const AxisOffsets offsets = axis_offsets(stencil, step);
  state_.recent.push_back({stamp, offsets.delta});
  if (state_.recent.size() > recent_pairs) state_.recent.erase(state_.recent.begin());
  accumulate(standardised(offsets), stamp);
  // Nothing is learned from pairs that already speak of misalignment.
  if (!state_.baseline && decide() == DriftVerdict::learning) learn(offsets.delta, stencil.current);
  state_.verdict = decide();
  return verdict();
}

std::string DriftMonitor::reason() const {
  if (verdict() == DriftVerdict::learning)
    return "learning the baseline: " + std::to_string(state_.learning.size()) + " of " +
           std::to_string(settings_.baseline_pairs) + " pairs";
  if (verdict() == DriftVerdict::calibrated) return "the extrinsic is the best of its neighbours";
  std::string words;
  const auto estimate = misalignment();
  for (int axis = 0; axis < 6; ++axis) {
    const double evidence = std::max(state_.cusum_up[axis], state_.cusum_down[axis]);
    if (evidence < settings_.cusum_h / 4 || !estimate) continue;
    if (!words.empty()) words += ", ";
    words += axis_in_words(axis, estimate->delta[axis]);
  }
  return "the LiDAR seems to have moved: " + (words.empty() ? "evidence is fading" : words);
}

std::optional<DriftMonitor::Estimate> DriftMonitor::misalignment() const {
  constexpr std::size_t least = 3;
  // Pairs from before the drift began would dilute the estimate.
  const Timestamp from = first_sign().value_or(Timestamp::min());
  std::vector<Vector6> offsets;
  for (const auto& observation : state_.recent)
    if (observation.stamp >= from) offsets.push_back(observation.delta);
  if (offsets.size() < least) return std::nullopt;
  Estimate estimate;
  for (int axis = 0; axis < 6; ++axis) {
    const double spread = state_.baseline ? state_.spread[axis] : typical_spread[axis];
    estimate.delta[axis] = median(along_axis(offsets, axis)) - (state_.baseline ? (*state_.baseline)[axis] : 0.0);
    // 1.25: the median's standard deviation over the mean's.
    estimate.sigma[axis] = 1.25 * spread / std::sqrt(static_cast<double>(offsets.size()));
  }
  return estimate;
}

std::optional<Timestamp> DriftMonitor::first_sign() const {
  if (verdict() != DriftVerdict::suspect && verdict() != DriftVerdict::drifted) return std::nullopt;
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
