#pragma once

#include <array>
#include <optional>
#include <string>

#include "calib/search.hpp"

namespace calib {

/// What is known of a misalignment before it is searched for: how far the LiDAR has moved in its own frame (rad, m).
/// An axis that is off by `reach` or more is known to be off at least that far, to that side.
struct Expectation {
  Vector6 delta = Vector6::Zero();
  Matrix6 covariance = Matrix6::Zero();
  Vector6 reach = Vector6::Constant(1e9);
};

/// The score that was normal at the starting extrinsic while nothing was wrong with it: mean over `pairs` pairs, and
/// standard deviation of one.
struct NormalScore {
  Objective objective;
  double mean = 0, deviation = 0;
  int pairs = 0;
};

struct RecalibrationSettings {
  /// The extrinsic stays within these of the starting one, per axis, in the LiDAR frame.
  SearchBounds bounds;
  /// False: only the rotation may change.
  bool translation = true;
  /// The gain on pairs held back must exceed this many of its own standard errors.
  double min_gain_sigmas = 2;
  /// A change that stays within these is refused: asked for without evidence of drift, it may be no more than the depth
  /// source's own bias. Zero where there is evidence.
  double min_change_rotation_rad = 0;
  double min_change_translation_m = 0;
  /// The evidence that made a recalibration necessary, where there is such.
  std::optional<Expectation> expected = {};
  /// Nothing where none was learned, or where the extrinsic was wrong when it was.
  std::optional<NormalScore> normal = {};
  /// As of `SearchSettings`.
  std::function<bool()> keep_going = {};
};

/// What a search for the extrinsic found. It is a value like any other: `accepted` says whether it may be used.
struct Recalibration {
  bool accepted = false;
  /// Which gate said no, in words, or why it was accepted; and which axes were left as they are.
  std::string reason;
  RigidTransform T_camera_lidar = RigidTransform::Identity();
  /// From the starting extrinsic: how far the LiDAR has moved in its own frame.
  Vector6 delta = Vector6::Zero();
  /// One standard deviation of `delta` (rad, m), by block bootstrap over the frames; where the translation was not
  /// moved, that of the rotation is for the translation as it is.
  Vector6 sigma = Vector6::Zero();
  /// Axes along which the extrinsic was free to move: those that the frames tell something of. Translation only where
  /// the pairs held back bore it out.
  std::array<bool, 6> moved{};
  double score_before = 0, score_after = 0;
  double held_back_before = 0, held_back_after = 0;
  int evaluations = 0;
};

/// Searches over `fit` (search.hpp, the default method) for the rotation alone and for all six parameters. `held_back`
/// frames take no part in that and decide whether translation is moved at all. Axes of which the frames tell nothing
/// are left as they are. What is found is accepted when all of these gates let it pass, in this order:
/// - two rotations at least and more than half of the axes to be moved are observable: few would take upon themselves
///   what is wrong with the others;
/// - it is inside the bounds, and larger than the least change;
/// - it is better than the start on the pairs held back;
/// - it does not contradict `expected`;
/// - brightness against reflectance does not contradict it: they know nothing of depth, so that depth that is suddenly
///   biased cannot fool them;
/// - the score is back to normal: a LiDAR that has moved, put right, scores as before; depth that has gone wrong does
/// not;
/// - searches from other starts end at the same place.
/// Deterministic.
///
/// Fails with `too_few_pairs` below three frames to fit or two held back, with `cancelled`, and as `search` does.
[[nodiscard]] Result<Recalibration> recalibrate(Frames fit, Frames held_back, const RigidTransform& T_camera_lidar,
                                                const RecalibrationSettings& settings);

}  // namespace calib
