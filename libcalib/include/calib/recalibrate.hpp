#pragma once

#include <array>
#include <optional>
#include <string>

#include "calib/search.hpp"

namespace calib {

/// A prior estimate of the misalignment: how far the LiDAR has moved in its own frame (rad, m). For an axis whose
/// `delta` is `reach` or more, it is a lower bound in that direction.
struct Expectation {
  Vector6 delta = Vector6::Zero();
  Matrix6 covariance = Matrix6::Zero();
  Vector6 reach = Vector6::Constant(1e9);
};

/// The baseline of the score at the starting extrinsic, from before the drift: mean over `pairs` pairs, and standard
/// deviation of one.
struct BaselineScore {
  Objective objective;
  double mean = 0, deviation = 0;
  int pairs = 0;
};

struct RecalibrationSettings {
  /// The extrinsic stays within these of the starting one, per axis, in the LiDAR frame.
  SearchBounds bounds;
  /// Depth comes from one image, by a network. Then only the rotation may change.
  bool monocular_depth = false;
  /// The gain on pairs held back must exceed this many of its own standard errors.
  double min_gain_sigmas = 2;
  /// A change within these is refused: without evidence of drift it may be the depth source's bias. Zero where there is
  /// evidence.
  double min_change_rotation_rad = 0;
  double min_change_translation_m = 0;
  /// The estimate of the drift monitor, where there is evidence of drift.
  std::optional<Expectation> expected = {};
  /// Nothing without a baseline, or where the extrinsic was wrong from the start.
  std::optional<BaselineScore> baseline_score = {};
  /// As of `SearchSettings`.
  std::function<bool()> keep_going = {};
};

/// What a search for the extrinsic found. It is a value like any other: `accepted` says whether it may be used.
struct Recalibration {
  bool accepted = false;
  /// The gate that refused it, with what other gates object, or why it was accepted, in words; and the axes that were
  /// not moved.
  std::string reason;
  RigidTransform T_camera_lidar = RigidTransform::Identity();
  /// From the starting extrinsic: how far the LiDAR has moved in its own frame.
  Vector6 delta = Vector6::Zero();
  /// One standard deviation of `delta` (rad, m), by block bootstrap over the frames; where the translation was not
  /// moved, that of the rotation is for the translation as it is.
  Vector6 sigma = Vector6::Zero();
  /// The free axes: those that are observable. Translation only where it is better on the pairs held back.
  std::array<bool, 6> moved{};
  double score_before = 0, score_after = 0;
  double held_back_before = 0, held_back_after = 0;
  int evaluations = 0;
};

/// Searches over `fit` (search.hpp, the default method) for the rotation alone and, but with monocular depth, for all
/// six parameters. The `held_back` frames take no part in the search; they decide whether translation is moved at all.
/// Unobservable axes are not moved. The result is accepted when it passes all of these gates, in this order:
/// - at least two rotations and more than half of the free axes are observable: fewer axes would absorb the
///   misalignment of the others;
/// - it is inside the bounds, and larger than the least change;
/// - it is better than the start on the pairs held back;
/// - it does not contradict `expected`;
/// - intensity (brightness against reflectance) does not contradict it: it does not depend on depth, so a sudden bias
/// of
///   the depth does not affect it;
/// - the score is that of the baseline again: correcting a displaced LiDAR restores it, a failed depth source does not;
/// - searches from other starts end at the same extrinsic.
/// Deterministic.
///
/// Fails with `too_few_pairs` below three frames to fit or two held back, with `cancelled`, and as `search` does.
[[nodiscard]] Result<Recalibration> recalibrate(Frames fit, Frames held_back, const RigidTransform& T_camera_lidar,
                                                const RecalibrationSettings& settings);

}  // namespace calib
