#pragma once

#include <array>
#include <functional>
#include <string>
#include <string_view>

#include "calib/mutual_information.hpp"

namespace calib {

/// What is maximised, and in which steps.
enum class Method {
  /// Ours. Normalised mutual information of ranks; from a coarse look around by few classes to many; where only the
  /// rotation is sought, depth ranked by tiles in the end, which a spatially varying bias of the depth cannot move; and
  /// intensity beside depth, which counts for as much as it shows: where it shows nothing (night, no reflectance), its
  /// score is the same everywhere.
  standard,
  /// The paper's D2D objective and Algorithm 1: one BOBYQA from the start.
  d2d,
  /// The paper's baseline: grey value against reflectance, likewise (Pandey 2015).
  i2i,
  /// The best that intensity alone can do: ranks, normalised, two stages.
  i2i_nmi,
};
/// "default", "d2d", "i2i", "i2i_nmi". Fails with `unknown_objective`.
[[nodiscard]] Result<Method> parse_method(std::string_view name);
[[nodiscard]] std::string_view to_string(Method method);
/// Whether frames need `FeatureSettings::linear`.
[[nodiscard]] bool needs_baseline_features(Method method);

struct SearchSettings {
  /// The extrinsic stays within these of the starting one, per axis, in the LiDAR frame.
  SearchBounds bounds;
  /// Orientations all around are tried (by the standard method; the others start where they start), and
  /// `bounds.rotation_rad` does not hold. Takes roll, pitch and yaw released.
  bool any_orientation = false;
  /// Axes (roll, pitch, yaw, x, y, z of the LiDAR at the start) that may move.
  std::array<bool, 6> released{true, true, true, true, true, true};
  /// Called with a share of the work done, 0 .. 1, now and then. May be empty.
  std::function<void(double)> progress = {};
  /// Called before each evaluation, some milliseconds apart; false ends the work, which then fails with `cancelled`.
  /// May be empty.
  std::function<bool()> keep_going = {};
};

/// Where a search ended.
struct SearchResult {
  RigidTransform T_camera_lidar = RigidTransform::Identity();
  /// From the start: how far the LiDAR has moved in its own frame.
  Vector6 delta = Vector6::Zero();
  /// The last stage's objective, and its score at the start and at the end.
  Objective objective;
  double score_before = 0, score_after = 0;
  /// The depth is biased across the image: its tiles alone would choose another rotation than the whole. The objective
  /// is then one that distrusts the whole. Found out with all six axes released; rotation alone always goes by tiles.
  bool depth_is_biased = false;
  int evaluations = 0;
  /// Why it ended, in words: "converged", "ends at the limit of pitch", "the optimiser's last run was cut short".
  std::string reason;
  bool ends_at_limit = false;
};

/// How sure the optimum is, in the LiDAR frame there (rad, m).
struct Uncertainty {
  /// By the curvature of the mean score and the scatter of the frames' gradients (sandwich estimate; Huber 1967).
  Matrix6 covariance = Matrix6::Zero();
  /// By resampling blocks of neighbouring frames and moving the optimum by one Newton step each (Kuensch 1989).
  Matrix6 bootstrap_covariance = Matrix6::Zero();
  /// Whether the frames tell anything of the axis: its curvature is significantly that of a hill.
  std::array<bool, 6> observable{};

  [[nodiscard]] Vector6 sigma() const { return bootstrap_covariance.diagonal().cwiseSqrt(); }
};

/// Finds the extrinsic that maximises the method's objective over `frames` (paper, Algorithm 1), by BOBYQA (Powell
/// 2009). With all six axes released it turns about a point 15 m in front of the camera, and goes along the directions
/// of the hill there, which straightens the valley in which pitch trades against z and yaw against y; near the top it
/// goes by quadratics through batches of samples, which look through the small hills that noise makes. Deterministic.
/// Fails with `too_few_pairs` without a frame, and with `search_failed` when nothing is in view or the optimiser
/// breaks.
[[nodiscard]] Result<SearchResult> search(Frames frames, const RigidTransform& T_camera_lidar, Method method,
                                          const SearchSettings& settings = {});

/// At the optimum `T_camera_lidar` of `objective`. Directions that the frames tell nothing of are as uncertain as the
/// bounds are wide; with all six axes released that is said of turns about the point ahead, so that the LiDAR's own
/// place may be less certain than its bounds. Axes that are not released have no standard deviation. One frame has no
/// scatter: the covariances are zero then, and no axis is observable; the same when `keep_going` ends it.
[[nodiscard]] Uncertainty uncertainty(Frames frames, const RigidTransform& T_camera_lidar, const Objective& objective,
                                      const SearchSettings& settings = {});

/// What drift is judged by: depth of the whole image, which is the sharpest; where a network guesses it, what errors
/// that are the same all over the image leave alone, tiles and intensity.
[[nodiscard]] Objective drift_objective(bool depth_is_guessed);

/// The objective of a method's last stage, as long as nothing speaks of biased depth.
[[nodiscard]] Objective final_objective(Method method, const std::array<bool, 6>& released);

}  // namespace calib
