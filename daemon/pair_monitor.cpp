#include "pair_monitor.hpp"

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

Result<PairMonitor::Evidence> PairMonitor::evaluate(const FramePair& pair) {
  const SceneThumbnail* last = last_scene_ ? &*last_scene_ : nullptr;
  if (auto good = check_pair(pair, camera_, last, settings_.quality); !good) return tl::unexpected(good.error());
  auto depth = depth_->estimate(pair);
  if (!depth) return tl::unexpected(depth.error());
  mask_depth(pair.image, settings_.quality.depth_range, *depth);
  if (auto good = check_depth(*depth, settings_.quality); !good) return tl::unexpected(good.error());
  auto features = make_features(pair, *depth, camera_, T_camera_lidar_,
                                {.bounds = settings_.bounds, .min_points = settings_.quality.min_points});
  if (!features) return tl::unexpected(features.error());

  last_scene_ = thumbnail(pair.image);
  Evidence evidence;
  const Objective objective = drift_objective(settings_.depth_is_guessed);
  evidence.stencil = evaluate_stencil(*features, T_camera_lidar_, {}, objective);
  AxisEvidence axes = axis_evidence(evidence.stencil, features->stamp);
  if (drift_.wants_response()) axes.response = evaluate_response(*features, T_camera_lidar_, {}, objective);
  evidence.verdict = drift_.observe(axes);
  kept_.push_back(std::move(*features));
  if (kept_.size() > wanted_pairs()) kept_.pop_front();
  return evidence;
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

Result<PairMonitor::Outcome> PairMonitor::recalibrate() const {
  const auto frames = eligible();
  if (frames.size() < wanted_pairs())
    return fail("not_ready", "only " + progress() + " good pairs are at hand; try again when there are more");
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
  auto result = calib::recalibrate(fit, held_back, T_camera_lidar_, settings);
  if (!result) return tl::unexpected(result.error());
  outcome.result = std::move(*result);
  return outcome;
}

void PairMonitor::adopt(const RigidTransform& T_camera_lidar) {
  T_camera_lidar_ = T_camera_lidar;
  drift_.restart();
  kept_.clear();
}

}  // namespace calib
