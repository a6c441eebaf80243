#pragma once

#include <deque>
#include <functional>
#include <memory>
#include <optional>

#include "calib/depth.hpp"
#include "calib/quality.hpp"
#include "calib/recalibrate.hpp"
#include "pair_state.hpp"

namespace calib {

struct PairMonitorSettings {
  int frames = 25;  // pairs to fit, at least 8; a quarter as many more are held back
  SearchBounds bounds;
  QualityLimits quality;
  DriftSettings drift;
  /// From one image, by a network: it errs alike in all images of a road, which shifts the optimum's translation by
  /// decimetres, on pairs held back too. Then recalibration turns the LiDAR only.
  bool depth_is_guessed = false;
};

/// Watches one camera-LiDAR pair: from a pair of samples to evidence, from evidence to a verdict, and from the pairs
/// kept to a new extrinsic. Knows no DDS and no clock; not thread-safe.
class PairMonitor {
 public:
  PairMonitor(const PairMonitorSettings& settings, const Camera& camera, std::unique_ptr<DepthEstimator> depth,
              const RigidTransform& T_camera_lidar, DriftState drift);

  /// What one pair shows at the extrinsic in force.
  struct Evidence {
    FeatureSet features;
    Stencil stencil;
    std::optional<Matrix6> response = {};  // while the baseline is learned
  };
  /// Depth, quality, features, stencil. Fails with the reason why this pair says nothing.
  [[nodiscard]] Result<Evidence> measure(const FramePair& pair);
  /// From evidence to a verdict; keeps the features for a recalibration.
  DriftVerdict observe(Evidence evidence);
  /// Both.
  [[nodiscard]] Result<DriftVerdict> evaluate(const FramePair& pair);

  /// Whether enough pairs from after the first sign of drift (any, when there is no sign) are kept.
  [[nodiscard]] bool can_recalibrate() const { return eligible().size() >= wanted_pairs(); }
  /// Pairs that a recalibration takes: those to fit and those held back.
  [[nodiscard]] std::size_t wanted_pairs() const;
  /// "12 of 31": pairs kept for a recalibration, and how many it takes.
  [[nodiscard]] std::string progress() const;

  struct Outcome {
    Recalibration result;
    std::vector<Timestamp> frames;
  };
  /// From the eligible pairs, of which every fifth is held back. Fails with `not_ready` when there are too few, and
  /// with `cancelled` when `keep_going` says no.
  [[nodiscard]] Result<Outcome> recalibrate(const std::function<bool()>& keep_going = {}) const;

  /// Puts an extrinsic in force: evidence and kept pairs belong to the old one and are forgotten. `drift` is what is
  /// known of the new one, if it was in force before.
  void adopt(const RigidTransform& T_camera_lidar, DriftState drift = {});
  /// What the pair evaluated last scores at any extrinsic. There is one.
  [[nodiscard]] double score_of_latest(const RigidTransform& T_camera_lidar) const;
  /// Forgets kept pairs, so that the next recalibration is made from new ones only.
  void forget_pairs() { kept_.clear(); }

  [[nodiscard]] const RigidTransform& T_camera_lidar() const { return T_camera_lidar_; }
  [[nodiscard]] const DriftMonitor& drift() const { return drift_; }

 private:
  [[nodiscard]] std::vector<const FeatureSet*> eligible() const;
  /// What the evidence of drift says; nothing where there is none, or none but that the extrinsic was wrong from the
  /// start.
  [[nodiscard]] std::optional<Expectation> expected() const;
  /// Of the extrinsic in force; nothing while it is being learned.
  [[nodiscard]] std::optional<NormalScore> normal_score() const;

  PairMonitorSettings settings_;
  Camera camera_;
  std::unique_ptr<DepthEstimator> depth_;
  RigidTransform T_camera_lidar_;
  DriftMonitor drift_;
  std::deque<FeatureSet> kept_;
  std::optional<SceneThumbnail> last_scene_;
};

}  // namespace calib
