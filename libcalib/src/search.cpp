#include "calib/search.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <string>
#include <vector>

#include "search_steps.hpp"

namespace calib {
namespace {

/// Bounds of the error that the estimate of the stages before may have.
SearchBounds still_open(const SearchSettings& settings, int parameters) {
  return {2 * radians_per_degree, parameters == 3 ? 0 : std::min(0.3, settings.bounds.translation_m)};
}

struct Optimum {
  RigidTransform T;
  Objective objective;
  bool depth_is_biased = false;
};

/// All six parameters from near the optimum. Tiles show whether the depth is biased across the image: the optimum by
/// tiles alone then has another rotation. Depth of the whole image gets little weight in that case.
Result<Optimum> finish_six(SearchSteps& steps, const RigidTransform& T_near) {
  constexpr double same_rotation_rad = 0.1 * radians_per_degree;
  const Objective whole = final_objective(Method::standard, {true, true, true, true, true, true});
  const Objective by_rotation = final_objective(Method::standard, {true, true, true, false, false, false});
  const Objective coarser = objective_of({{.ranks_per_class = 8}});
  const Matrix6 directions = steps.principal_axes(T_near, objective_of({{.ranks_per_class = 8}}, 2));
  // A wide radius at first: a flat valley is full of local maxima.
  const auto T_middle = steps.climb_along(T_near, directions, coarser, {.radius = 4, .to_the_maximum = false});
  if (!T_middle) return propagate(T_middle);
  const auto found = steps.climb_along(*T_middle, directions, whole, {});
  if (!found) return propagate(found);
  const auto turned = [&](const Eigen::VectorXd& x) {
    Vector6 delta = Vector6::Zero();
    delta.head<3>() = same_rotation_rad * x;
    return RigidTransform(*found * perturbation(delta));
  };
  const auto by_tiles = steps.climb(3, turned, by_rotation, {.batches = 2});
  if (!by_tiles) return propagate(by_tiles);
  if (rotation_angle_rad(found->inverse() * *by_tiles) < same_rotation_rad) return Optimum{*found, whole};
  Objective mostly_tiles = whole;
  mostly_tiles.terms[0].weight = 0.1;
  const auto again = steps.climb_along(*by_tiles, directions, mostly_tiles, {});
  if (!again) return propagate(again);
  return Optimum{*again, mostly_tiles, true};
}

Result<Optimum> search_standard(SearchSteps& steps, const RigidTransform& T_start, const SearchSettings& settings) {
  constexpr double near_rad = 15 * radians_per_degree;
  const int parameters = steps.parameters();
  RigidTransform T = T_start;
  SearchBounds bounds = settings.bounds;
  if (settings.any_orientation) bounds.rotation_rad = std::numbers::pi;
  steps.recull(T, bounds);
  if (parameters != 0 && (settings.any_orientation || settings.bounds.rotation_rad > 2.5 * radians_per_degree)) {
    const auto found = steps.coarse();
    if (!found) return propagate(found);
    T = *found;
    if (bounds.rotation_rad > near_rad) steps.recull(T, {near_rad, bounds.translation_m});
  }
  for (const int stage : parameters == 6 ? std::vector<int>{3, 6} : std::vector<int>{parameters}) {
    const Objective coarser =
        objective_of({{.ranks_per_class = 8}}, stage == 6 ? 2 : 4);  // translation needs more points
    const auto better = steps.maximise(T, stage, 0.7, coarser);
    if (!better) return propagate(better);
    T = *better;
    steps.report_progress(stage == parameters ? 0.7 : 0.6);
  }
  steps.recull(T, still_open(settings, parameters));
  if (parameters == 6) return finish_six(steps, T);
  const Objective last = final_objective(Method::standard, settings.free_axes);
  const auto found = steps.maximise_again(T, parameters, 0.3, last);
  if (!found) return propagate(found);
  return Optimum{*found, last};
}

/// Few classes give a wide basin.
Objective coarser_monocular(int stride) {
  using enum FeaturePair;
  return objective_of({{tiled_depth, 1, 16, true}, {intensity, 6, 16, true}, {edges, 1, 8, true}}, stride);
}

/// The rotation alone. A grid search finds where to begin, because the maximum is sharp, and the start itself is one
/// beginning more; the best end counts.
Result<RigidTransform> turn_monocular(SearchSteps& steps, const RigidTransform& T_base, double reach_rad) {
  constexpr double wide_rad = 6 * radians_per_degree;
  const Objective last = drift_objective(true);
  const double spacing = std::clamp(reach_rad / 5, 1.5 * radians_per_degree, 2.5 * radians_per_degree);
  auto beginnings = steps.best_of_grid(T_base, reach_rad, spacing, coarser_monocular(reach_rad > wide_rad ? 32 : 8),
                                       reach_rad > wide_rad ? 6 : 3);
  const auto is_base = [&](const RigidTransform& beginning) { return beginning.isApprox(T_base); };
  if (std::ranges::none_of(beginnings, is_base)) beginnings.push_back(T_base);
  RigidTransform best = T_base;
  double most = -std::numeric_limits<double>::infinity();
  for (const RigidTransform& beginning : beginnings) {
    const auto near = steps.maximise(beginning, 3, 0.7, coarser_monocular(4));
    if (!near) return near;
    const auto found = steps.maximise_again(*near, 3, 0.3, last);
    if (!found) return found;
    if (const double value = steps.value(*found, last); value > most) best = *found, most = value;
  }
  return best;
}

/// With monocular depth. Its bias moves the maximum of depth alone by degrees where a scene has little else, so that
/// brightness and edges have their say from the beginning, but for bounds so wide that only depth leads the way.
Result<Optimum> search_monocular(SearchSteps& steps, const RigidTransform& T_start, const SearchSettings& settings) {
  constexpr double farthest_rad = 30 * radians_per_degree, near_rad = 6 * radians_per_degree;
  const Objective last = drift_objective(true);
  const int parameters = steps.parameters();
  RigidTransform T = T_start;
  SearchBounds bounds = settings.bounds;
  if (settings.any_orientation) bounds.rotation_rad = std::numbers::pi;
  steps.recull(T, bounds);
  if (parameters == 0) {
    const auto near = steps.maximise(T, 0, 0.7, coarser_monocular(4));
    if (!near) return propagate(near);
    const auto found = steps.maximise_again(*near, 0, 0.3, last);
    if (!found) return propagate(found);
    return Optimum{*found, last};
  }
  if (bounds.rotation_rad > farthest_rad) {
    const auto found = steps.coarse();
    if (!found) return propagate(found);
    T = *found;
    bounds.rotation_rad = near_rad;
    steps.recull(T, {farthest_rad, bounds.translation_m});
  }
  const auto turned = turn_monocular(steps, T, bounds.rotation_rad);
  if (!turned) return propagate(turned);
  if (parameters == 3) return Optimum{*turned, last};
  steps.report_progress(0.6);
  steps.recull(*turned, still_open(settings, parameters));
  const auto near = steps.maximise(*turned, 6, 0.7, coarser_monocular(2));
  if (!near) return propagate(near);
  const auto found = steps.climb_along(*near, steps.principal_axes(*near, last), last, {.radius = 2});
  if (!found) return propagate(found);
  return Optimum{*found, last};
}

/// As the paper does it: the six parameters themselves, from the start, with the optimiser's usual first step of a
/// quarter of the bound.
Result<Optimum> search_as_published(SearchSteps& steps, const RigidTransform& T_start, Method method,
                                    const SearchSettings& settings) {
  double first_step = std::numeric_limits<double>::infinity();
  for (int axis = 0; axis < 6; ++axis)
    if (settings.free_axes[axis]) first_step = std::min(first_step, steps.bound(axis) / 4);
  const Objective last = final_objective(method, settings.free_axes);
  if (method != Method::i2i_nmi) {
    const auto found = steps.maximise(T_start, 0, first_step, last);
    if (!found) return propagate(found);
    return Optimum{*found, last};
  }
  const Objective coarser = objective_of({{FeaturePair::intensity, 1, 8, true}});
  const auto near = steps.maximise(T_start, 0, first_step, coarser);
  if (!near) return propagate(near);
  const auto found = steps.maximise_again(*near, 0, std::min(first_step, 0.3), last);
  if (!found) return propagate(found);
  return Optimum{*found, last};
}

}  // namespace

Objective final_objective(Method method, const std::array<bool, 6>& free_axes, bool monocular_depth) {
  using enum FeaturePair;
  switch (method) {
    case Method::d2d:
      return objective_of({{linear_depth, 1, 1, false}});
    case Method::i2i:
      return objective_of({{linear_intensity, 1, 1, false}});
    case Method::i2i_nmi:
      return objective_of({{fine_intensity, 1, 4, true}});
    case Method::standard:
      break;
  }
  if (monocular_depth) return drift_objective(true);
  // Tiles keep a bias of the depth out of the rotation. They also flatten the valley in which pitch and z are
  // correlated, so that where translation is free, depth of the whole image is a term too. Depth that is biased moves
  // the optimum's x by centimetres, which edges do not.
  if (!std::any_of(free_axes.begin() + 3, free_axes.end(), [](bool axis) { return axis; }))
    return objective_of({{tiled_depth, 1, 8, true}, {intensity, 3, 8, true}});
  return objective_of({{depth, 1, 4, true}, {tiled_depth, 1, 8, true}, {intensity, 6, 8, true}, {edges, 1, 8, true}});
}

Objective drift_objective(bool monocular_depth) {
  using enum FeaturePair;
  if (!monocular_depth) return depth_objective;
  return objective_of({{tiled_depth, 1, 8, true}, {intensity, 6, 8, true}, {edges, 1, 8, true}});
}

Result<SearchResult> search(Frames frames, const RigidTransform& T_camera_lidar, Method method,
                            const SearchSettings& settings) {
  if (frames.empty()) return fail(ErrorCode::too_few_pairs, "there is no frame to search with");
  if (std::ranges::none_of(settings.free_axes, [](bool axis) { return axis; }))
    return fail(ErrorCode::search_failed, "no axis is free");
  if (!T_camera_lidar.matrix().allFinite()) return fail(ErrorCode::search_failed, "the extrinsic is not a number");
  SearchSteps steps(frames, T_camera_lidar, settings);
  if (settings.any_orientation && steps.parameters() == 0)
    return fail(ErrorCode::search_failed,
                "for any orientation roll, pitch and yaw must be free, and all of x, y, z or none");
  const auto found = method != Method::standard ? search_as_published(steps, T_camera_lidar, method, settings)
                     : settings.monocular_depth ? search_monocular(steps, T_camera_lidar, settings)
                                                : search_standard(steps, T_camera_lidar, settings);
  if (steps.cancelled()) return fail(ErrorCode::cancelled, "the search was ended before it was done");
  if (!found) return propagate(found);

  SearchResult result;
  result.T_camera_lidar = found->T;
  result.delta = steps.delta_of(found->T);
  result.objective = found->objective;
  result.depth_is_biased = found->depth_is_biased;
  const Score before = mean_score(frames, T_camera_lidar, found->objective);
  const Score after = mean_score(frames, found->T, found->objective);
  if (after.points < min_scored_points)
    return fail(ErrorCode::search_failed, "hardly a LiDAR point is in view; do camera and LiDAR look the same way?");
  result.score_before = before.value;
  result.score_after = after.value;
  result.evaluations = steps.evaluations();
  result.reason = steps.exhausted() ? "the optimiser's last run was cut short" : "converged";
  for (int axis = settings.any_orientation ? 3 : 0; axis < 6; ++axis)
    if (settings.free_axes[axis] && std::abs(result.delta[axis]) > 0.98 * steps.limit(axis)) {
      result.reason = "ends at the limit of " + std::string(axis_names[axis]);
      result.ends_at_limit = true;
    }
  steps.report_progress(1);
  return result;
}

Result<Method> parse_method(std::string_view name) {
  for (const Method method : {Method::standard, Method::d2d, Method::i2i, Method::i2i_nmi})
    if (name == to_string(method)) return method;
  return fail(ErrorCode::unknown_objective,
              "objective '" + escape_control(name) + "' is not known; there are default, d2d, i2i and i2i_nmi");
}

std::string_view to_string(Method method) {
  switch (method) {
    case Method::d2d:
      return "d2d";
    case Method::i2i:
      return "i2i";
    case Method::i2i_nmi:
      return "i2i_nmi";
    case Method::standard:
      break;
  }
  return "default";
}

bool needs_baseline_features(Method method) { return method != Method::standard; }

}  // namespace calib
