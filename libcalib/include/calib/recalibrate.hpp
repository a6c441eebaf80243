#pragma once

#include <string>

#include "calib/search.hpp"

namespace calib {

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
};

/// What a search for the extrinsic found. It is a value like any other: `accepted` says whether it may be used.
struct Recalibration {
  bool accepted = false;
  /// Which gate said no, in words, or why it was accepted.
  std::string reason;
  RigidTransform T_camera_lidar = RigidTransform::Identity();
  /// From the starting extrinsic: how far the LiDAR has moved in its own frame.
  Vector6 delta = Vector6::Zero();
  /// One standard deviation of `delta` (rad, m), by block bootstrap over the frames; where the translation was not
  /// changed, that of the rotation is for the translation as it is.
  Vector6 sigma = Vector6::Zero();
  /// False: the pairs held back did not bear out a translation, so only the rotation was changed.
  bool translation_changed = false;
  double score_before = 0, score_after = 0;
  double held_back_before = 0, held_back_after = 0;
  int evaluations = 0;
};

/// Searches over `fit` (search.hpp, the default method) for the rotation alone and for all six parameters. `held_back`
/// frames take no part in that and decide: whether translation is moved at all, and whether the result is better than
/// the start. Deterministic.
///
/// Fails with `too_few_pairs` below three frames to fit or two held back, and as `search` does.
[[nodiscard]] Result<Recalibration> recalibrate(Frames fit, Frames held_back, const RigidTransform& T_camera_lidar,
                                                const RecalibrationSettings& settings);

}  // namespace calib
