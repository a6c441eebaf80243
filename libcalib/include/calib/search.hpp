#pragma once

#include <array>
#include <functional>
#include <string>
#include <string_view>

#include "calib/mutual_information.hpp"

namespace calib {

/// What is maximised, and in which steps.
enum class Method {
  /// calibd's own. Normalised mutual information of ranks, from a coarse grid search by few classes to many. Where only
  /// the rotation is searched, the last stage ranks depth by tiles, so that a spatially varying bias of the depth has
  /// no effect. Intensity is a second term; where it carries no information (night, no reflectance) it is constant.
  /// Where
  /// translation is searched, edges are another, which a bias of the depth does not reach. With monocular depth all
  /// stages use tiles, intensity and edges.
  standard,
  /// The paper's D2D objective and Algorithm 1: one BOBYQA from the start.
  d2d,
  /// The paper's baseline: grey value against reflectance, likewise (Pandey 2015).
  i2i,
  /// The best objective of intensity alone: ranks, normalised, two stages.
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
  /// The standard method searches all orientations, and `bounds.rotation_rad` does not apply; the other methods start
  /// at the given one. Roll, pitch and yaw must be free.
  bool any_orientation = false;
  /// Axes (roll, pitch, yaw, x, y, z of the LiDAR at the start) that may move.
  std::array<bool, 6> free_axes{true, true, true, true, true, true};
  /// Depth comes from one image, by a network: the standard method then relies on brightness and edges as much.
  bool monocular_depth = false;
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
  /// The depth is biased across the image: by its tiles alone the optimum is another rotation than by the whole image.
  /// The objective then gives the whole image little weight. Tested with all six axes free; rotation alone always uses
  /// tiles.
  bool depth_is_biased = false;
  int evaluations = 0;
  /// Why it ended, in words: "converged", "ends at the limit of pitch", "the optimiser's last run was cut short".
  std::string reason;
  bool ends_at_limit = false;
};

/// Covariance of the optimum, in the LiDAR frame there (rad, m).
struct Uncertainty {
  /// By the curvature of the mean score and the scatter of the frames' gradients (sandwich estimate; Huber 1967).
  Matrix6 covariance = Matrix6::Zero();
  /// By resampling blocks of neighbouring frames and moving the optimum by one Newton step each (Kuensch 1989).
  Matrix6 bootstrap_covariance = Matrix6::Zero();
  /// Whether the frames carry information about the axis: its curvature is significantly that of a maximum.
  std::array<bool, 6> observable{};

  [[nodiscard]] Vector6 sigma() const { return bootstrap_covariance.diagonal().cwiseSqrt(); }
};

/// Finds the extrinsic that maximises the method's objective over `frames` (paper, Algorithm 1), by BOBYQA (Powell
/// 2009). With all six axes free it rotates about a point 15 m in front of the camera and searches along the principal
/// axes of the curvature there, because pitch is correlated with z and yaw with y. Near the maximum it fits quadratics
/// to batches of samples, which average out the local maxima that noise makes. Deterministic. Fails with
/// `too_few_pairs` without a frame, and with `search_failed` when no point is in view or the optimiser fails.
[[nodiscard]] Result<SearchResult> search(Frames frames, const RigidTransform& T_camera_lidar, Method method,
                                          const SearchSettings& settings = {});

/// At the optimum `T_camera_lidar` of `objective`. Unobservable directions are as uncertain as the bounds are wide;
/// with all six axes free the directions are rotations about the point ahead, so that the standard deviation of the
/// LiDAR's position may exceed its bounds. Axes that are not free have a standard deviation of zero. One frame has no
/// scatter: then, and when `keep_going` ends it, the covariances are zero and no axis is observable.
[[nodiscard]] Uncertainty uncertainty(Frames frames, const RigidTransform& T_camera_lidar, const Objective& objective,
                                      const SearchSettings& settings = {});

/// The objective of the drift monitor: depth of the whole image, which has the sharpest maximum; for monocular depth
/// tiles, intensity and edges, which errors that vary over the image affect less.
[[nodiscard]] Objective drift_objective(bool monocular_depth);

/// The objective of a method's last stage, unless the depth is found to be biased.
[[nodiscard]] Objective final_objective(Method method, const std::array<bool, 6>& free_axes,
                                        bool monocular_depth = false);

}  // namespace calib
