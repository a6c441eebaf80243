#include "calib/recalibrate.hpp"

#include <algorithm>
#include <cmath>
#include <string>

#include "recalibration_gates.hpp"
#include "search_steps.hpp"

namespace calib {
namespace {

/// A smaller translation is not looked for (`DriftSettings::negligible_translation_m`), and not corrected.
constexpr double negligible_translation_m = 0.02;
constexpr std::array<bool, 6> rotation_axes{true, true, true, false, false, false};

bool any(const std::array<bool, 6>& axes) {
  return std::ranges::any_of(axes, [](bool axis) { return axis; });
}

std::string names_of(const std::array<bool, 6>& axes) {
  std::string names;
  for (int axis = 0; axis < 6; ++axis)
    if (axes[axis]) names += (names.empty() ? "" : ", ") + std::string(axis_names[axis]);
  return names;
}

/// A search's result, and which axes it was free to move.
struct Found {
  SearchResult result;
  std::array<bool, 6> free_axes{};
  Uncertainty uncertainty;
  /// Axes that were wanted and are not observable.
  std::array<bool, 6> left{};
};

/// Searches with the axes `wanted`, then again without those that are not observable. A rotation that ends at its bound
/// stays free: its optimum may lie further out, which a gate refuses.
Result<Found> search_observable(Frames fit, const RigidTransform& T, SearchResult first,
                                const std::array<bool, 6>& wanted, const RecalibrationSettings& how, int& evaluations) {
  const SearchBounds& bounds = how.bounds;
  Found found{.result = std::move(first), .free_axes = wanted, .uncertainty = {}, .left = {}};
  while (true) {
    const SearchSettings settings{.bounds = bounds,
                                  .free_axes = found.free_axes,
                                  .monocular_depth = how.monocular_depth,
                                  .keep_going = how.keep_going};
    found.uncertainty = uncertainty(fit, found.result.T_camera_lidar, found.result.objective, settings);
    std::array<bool, 6> kept = found.free_axes;
    for (int axis = 0; axis < 6; ++axis) {
      const bool at_bound = axis < 3 && std::abs(found.result.delta[axis]) > 0.98 * bounds.rotation_rad;
      kept[axis] = kept[axis] && (at_bound || found.uncertainty.observable[axis]);
      found.left[axis] = wanted[axis] && !kept[axis];
    }
    if (kept == found.free_axes) return found;
    found.free_axes = kept;
    if (!any(kept)) {
      found.result.T_camera_lidar = T;
      found.result.delta.setZero();
      return found;
    }
    auto again = search(
        fit, T, Method::standard,
        {.bounds = bounds, .free_axes = kept, .monocular_depth = how.monocular_depth, .keep_going = how.keep_going});
    if (!again) return propagate(again);
    evaluations += again->evaluations;
    found.result = *std::move(again);
  }
}

/// Whether the pairs held back say that the LiDAR is shifted, too, and not only turned. The rotation alone that is
/// compared with is the best by the same objective, near the one that was found by another.
Result<bool> is_shifted(Frames fit, Frames held_back, const SearchResult& rotated, const SearchResult& moved,
                        const RecalibrationSettings& how, int& evaluations) {
  if (moved.delta.tail<3>().norm() < negligible_translation_m) return false;
  SearchSteps steps(fit, rotated.T_camera_lidar, {.bounds = how.bounds, .keep_going = how.keep_going});
  const auto turned = [&](const Eigen::VectorXd& x) {
    Vector6 delta = Vector6::Zero();
    delta.head<3>() = 0.1 * radians_per_degree * x;
    return RigidTransform(rotated.T_camera_lidar * perturbation(delta));
  };
  const auto best = steps.climb(3, turned, moved.objective, {.batches = 2});
  if (!best) return propagate(best);
  evaluations += steps.evaluations();
  return gain(held_back, *best, moved.T_camera_lidar, moved.objective).exceeds(how.min_gain_sigmas);
}

void add_scores(Recalibration& result, Frames fit, Frames held_back, const RigidTransform& T_before,
                const Objective& objective) {
  result.score_before = mean_score(fit, T_before, objective).value;
  result.score_after = mean_score(fit, result.T_camera_lidar, objective).value;
  result.held_back_before = mean_score(held_back, T_before, objective).value;
  result.held_back_after = mean_score(held_back, result.T_camera_lidar, objective).value;
}

/// The first gate's objection, and what the others say, but for the expensive last one: it is asked only when all
/// agree.
Result<Objection> judge(const Candidate& candidate, const Gain& held_back, const RecalibrationSettings& settings,
                        int& evaluations) {
  const Objection objections[] = {
      insufficient_observability(candidate),
      outside_bounds(candidate),
      no_more_than_bias(candidate, settings),
      not_better(held_back, settings),
      settings.expected ? contradicts_expectation(candidate, *settings.expected) : Objection(),
      contradicts_intensity(candidate),
      settings.baseline_score ? score_not_restored(candidate, *settings.baseline_score) : Objection()};
  Objection all;
  for (const Objection& objection : objections)
    if (objection) all = all ? *all + "; also " + *objection : *objection;
  if (all) return all;
  return not_repeatable(candidate, settings.keep_going, evaluations);
}

}  // namespace

Result<Recalibration> recalibrate(Frames fit, Frames held_back, const RigidTransform& T_camera_lidar,
                                  const RecalibrationSettings& settings) {
  if (fit.size() < 3 || held_back.size() < 2)
    return fail(ErrorCode::too_few_pairs, std::to_string(fit.size()) + " pairs to fit and " +
                                              std::to_string(held_back.size()) +
                                              " held back; at least 3 and 2 are needed");
  const SearchSettings everything{
      .bounds = settings.bounds, .monocular_depth = settings.monocular_depth, .keep_going = settings.keep_going};
  SearchSettings rotation = everything;
  rotation.free_axes = rotation_axes;
  const auto rotated = search(fit, T_camera_lidar, Method::standard, rotation);
  if (!rotated) return propagate(rotated);
  const auto moved = settings.monocular_depth ? rotated : search(fit, T_camera_lidar, Method::standard, everything);
  if (!moved) return propagate(moved);
  const Objective& objective = moved->objective;

  Recalibration result;
  result.evaluations = rotated->evaluations + (settings.monocular_depth ? 0 : moved->evaluations);
  const auto shifted = is_shifted(fit, held_back, *rotated, *moved, settings, result.evaluations);
  if (!shifted) return propagate(shifted);
  const auto found =
      search_observable(fit, T_camera_lidar, *shifted ? *moved : *rotated,
                        *shifted ? everything.free_axes : rotation.free_axes, settings, result.evaluations);
  if (!found) return propagate(found);
  result.moved = found->free_axes;
  result.T_camera_lidar = found->result.T_camera_lidar;
  result.delta = found->result.delta;
  result.sigma = found->uncertainty.sigma();
  if (!*shifted)
    result.sigma.tail<3>() = uncertainty(fit, result.T_camera_lidar, objective, everything).sigma().tail<3>();
  add_scores(result, fit, held_back, T_camera_lidar, objective);

  const Candidate candidate{.fit = fit,
                            .held_back = held_back,
                            .T_before = T_camera_lidar,
                            .T_after = result.T_camera_lidar,
                            .delta = result.delta,
                            .covariance = found->uncertainty.bootstrap_covariance,
                            .free_axes = found->free_axes,
                            .left = found->left,
                            .monocular_depth = settings.monocular_depth,
                            .at_limit = found->result.ends_at_limit ? found->result.reason : ""};
  const Gain gained = gain(held_back, T_camera_lidar, result.T_camera_lidar, objective);
  auto objection = judge(candidate, gained, settings, result.evaluations);
  if (!objection) return propagate(objection);
  if (settings.keep_going && !settings.keep_going())
    return fail(ErrorCode::cancelled, "the recalibration was ended before it was done");
  result.accepted = !objection->has_value();
  result.reason = result.accepted ? "better on pairs held back: " + held_back_in_words(gained) : std::move(**objection);
  if (any(found->left)) result.reason += "; not observable and left as it was: " + names_of(found->left);
  return result;
}

}  // namespace calib
