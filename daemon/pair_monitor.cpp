#include "pair_monitor.hpp"

#include <cmath>

namespace calib {

PairMonitor::PairMonitor(const PairMonitorSettings& settings, const Camera& camera,
                         std::unique_ptr<DepthEstimator> depth, const RigidTransform& T_camera_lidar, DriftState drift)
    : settings_(settings),
      camera_(camera),
      depth_(std::move(depth)),
      T_camera_lidar_(T_camera_lidar),
      drift_(settings.drift, std::move(drift)) {}

std::size_t PairMonitor::wanted_pairs() const {
  return static_cast<std::size_t>(settings_.frames + settings_.frames / 4);
}

Result<PairMonitor::Evidence> PairMonitor::measure(const FramePair& pair) {
  const SceneThumbnail* last = last_scene_ ? &*last_scene_ : nullptr;
  if (auto good = check_pair(pair, camera_, last, settings_.quality); !good) return propagate(good);
  auto depth = depth_->estimate(pair);
  if (!depth) return propagate(depth);
  mask_depth(pair.image, settings_.quality.depth_range, *depth);
  if (auto good = check_depth(*depth, settings_.quality); !good) return propagate(good);
  auto features = make_features(pair, *depth, camera_, T_camera_lidar_,
                                {.bounds = settings_.bounds, .min_points = settings_.quality.min_points});
  if (!features) return propagate(features);

  last_scene_ = thumbnail(pair.image);
  const Objective objective = drift_objective(settings_.depth_is_guessed);
  Evidence evidence{.features = std::move(*features), .stencil = {}};
  evidence.stencil = evaluate_stencil(evidence.features, T_camera_lidar_, {}, objective);
  if (drift_.wants_response()) evidence.response = evaluate_response(evidence.features, T_camera_lidar_, {}, objective);
  return evidence;
}

DriftVerdict PairMonitor::observe(Evidence evidence) {
  AxisEvidence axes = axis_evidence(evidence.stencil, evidence.features.stamp);
  axes.response = evidence.response;
  kept_.push_back(std::move(evidence.features));
  if (kept_.size() > wanted_pairs()) kept_.pop_front();
  return drift_.observe(axes);
}

Result<DriftVerdict> PairMonitor::evaluate(const FramePair& pair) {
  return measure(pair).map([this](Evidence&& evidence) { return observe(std::move(evidence)); });
}

std::vector<const FeatureSet*> PairMonitor::eligible() const {
  const Timestamp from = drift_.first_sign().value_or(Timestamp::min());
  std::vector<const FeatureSet*> frames;
  for (const FeatureSet& features : kept_)
    if (features.stamp >= from) frames.push_back(&features);
  return frames;
}

std::string PairMonitor::progress() const {
  return std::to_string(eligible().size()) + " of " + std::to_string(wanted_pairs());
}

std::optional<Expectation> PairMonitor::expected() const {
  const auto sign = drift_.first_sign();
  const auto estimate = drift_.misalignment();
  if (!sign || *sign == Timestamp::min() || !estimate) return std::nullopt;
  Expectation expected{.delta = estimate->delta, .covariance = estimate->covariance};
  for (int axis = 0; axis < 6; ++axis) expected.reach[axis] = 1.9 * StencilStep{}.of_axis(axis);  // a little less than 2
  return expected;
}

std::optional<NormalScore> PairMonitor::normal_score() const {
  if (!drift_.learned()) return std::nullopt;
  const DriftBaseline& baseline = drift_.state().baseline;
  return NormalScore{.objective = drift_objective(settings_.depth_is_guessed),
                     .mean = baseline.score,
                     .deviation = std::sqrt(baseline.score_squares / (baseline.pairs - 1)),
                     .pairs = baseline.pairs};
}

Result<PairMonitor::Outcome> PairMonitor::recalibrate(const std::function<bool()>& keep_going) const {
  const auto frames = eligible();
  if (frames.size() < wanted_pairs())
    return fail(ErrorCode::not_ready, "only " + progress() + " good pairs are at hand; try again when there are more");
  std::vector<const FeatureSet*> fit, held_back;
  Outcome outcome;
  for (std::size_t i = 0; i < frames.size(); ++i) {
    (i % 5 == 4 ? held_back : fit).push_back(frames[i]);
    outcome.frames.push_back(frames[i]->stamp);
  }
  RecalibrationSettings settings{.bounds = settings_.bounds, .translation = !settings_.depth_is_guessed};
  if (!drift_.first_sign()) {
    settings.min_change_rotation_rad = settings_.drift.max_bias_rotation_rad;
    settings.min_change_translation_m = settings_.drift.max_bias_translation_m;
  }
  settings.expected = expected();
  settings.normal = normal_score();
  settings.keep_going = keep_going;
  auto result = calib::recalibrate(fit, held_back, T_camera_lidar_, settings);
  if (!result) return propagate(result);
  outcome.result = std::move(*result);
  return outcome;
}

void PairMonitor::adopt(const RigidTransform& T_camera_lidar, DriftState drift) {
  T_camera_lidar_ = T_camera_lidar;
  drift_ = DriftMonitor(settings_.drift, std::move(drift));
  kept_.clear();
}

double PairMonitor::score_of_latest(const RigidTransform& T_camera_lidar) const {
  return score(kept_.back(), T_camera_lidar, drift_objective(settings_.depth_is_guessed)).value;
}

}  // namespace calib
