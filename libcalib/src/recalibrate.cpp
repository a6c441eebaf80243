#include "calib/recalibrate.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <nlopt.hpp>

namespace calib {
namespace {

constexpr double pivot_distance_m = 15;
/// Search variables are in these units, so that one unit matters about equally in each.
constexpr double rotation_unit_rad = radians_per_degree, translation_unit_m = 0.25;

/// The mean score over frames, maximised over extrinsics near a starting one.
class Search {
 public:
  Search(Frames frames, const RigidTransform& T_start, const SearchBounds& bounds)
      : frames_(frames), T_start_(T_start), bounds_(bounds) {}

  /// The mean score less a penalty for leaving the bounds: they are a box in the LiDAR's own parameters, which is none in
  /// the search variables.
  [[nodiscard]] double value(const RigidTransform& T, const ObjectiveOptions& options) {
    ++evaluations_;
    const Vector6 delta = perturbation_parameters(T_start_.inverse() * T);
    double outside = 0;
    for (int axis = 0; axis < 6; ++axis) outside += std::max(0.0, std::abs(delta[axis]) / limit(axis) - 1);
    return mean_score(frames_, T, options).value - outside;
  }

  /// The best of a coarse grid of pitch and yaw: BOBYQA alone finds its way from about two degrees.
  [[nodiscard]] RigidTransform coarse() {
    constexpr ObjectiveOptions options{.bins = 16, .stride = 8};
    constexpr double step_rad = 1.5 * radians_per_degree;
    const double reach = std::floor(bounds_.rotation_rad / step_rad) * step_rad;
    RigidTransform best = T_start_;
    double best_value = value(best, options);
    for (double pitch = -reach; pitch <= reach + 1e-9; pitch += step_rad)
      for (double yaw = -reach; yaw <= reach + 1e-9; yaw += step_rad) {
        Vector6 delta = Vector6::Zero();
        delta[1] = pitch;
        delta[2] = yaw;
        const RigidTransform T = T_start_ * perturbation(delta);
        if (const double result = value(T, options); result > best_value) {
          best_value = result;
          best = T;
        }
      }
    return best;
  }

  /// Maximises over rotations (`parameters` 3) or rotations and translations (6) about `pivot` (LiDAR frame, m), from
  /// `T_base`. Returns the best extrinsic seen: where roundoff ends the search, NLopt's last point is not always that.
  [[nodiscard]] Result<RigidTransform> maximise(const RigidTransform& T_base, const Eigen::Vector3d& pivot,
                                                int parameters, double first_step, const ObjectiveOptions& options) {
    RigidTransform best = T_base;
    double best_value = value(T_base, options);
    // Turning about the pivot shifts the LiDAR, so its translation needs more room; `value` keeps the real bounds.
    const double rotation_room = 2 * bounds_.rotation_rad / rotation_unit_rad;
    const double translation_room =
        2 * (bounds_.translation_m + pivot.norm() * bounds_.rotation_rad) / translation_unit_m;
    std::vector<double> room(parameters, rotation_room);
    std::fill(room.begin() + 3, room.end(), translation_room);

    const auto objective = [&](const std::vector<double>& x) {
      Vector6 delta = Vector6::Zero();
      for (int i = 0; i < parameters; ++i)  // BOBYQA may step a little over its bounds
        delta[i] = std::clamp(x[i], -room[i], room[i]) * (i < 3 ? rotation_unit_rad : translation_unit_m);
      const RigidTransform T = T_base * perturbation_about(delta, pivot);
      const double result = value(T, options);
      if (result > best_value) {
        best_value = result;
        best = T;
      }
      return result;
    };
    using Objective = decltype(objective);
    try {
      nlopt::opt optimiser(nlopt::LN_BOBYQA, static_cast<unsigned>(parameters));
      optimiser.set_upper_bounds(room);
      for (double& bound : room) bound = -bound;
      optimiser.set_lower_bounds(room);
      for (double& bound : room) bound = -bound;
      optimiser.set_initial_step(first_step);
      optimiser.set_xtol_abs(2e-3);
      optimiser.set_maxeval(400);
      optimiser.set_max_objective(
          [](const std::vector<double>& x, std::vector<double>&, void* context) {
            return (*static_cast<const Objective*>(context))(x);
          },
          const_cast<void*>(static_cast<const void*>(&objective)));
      std::vector<double> x(parameters, 0.0);
      double last_value = 0;
      optimiser.optimize(x, last_value);
    } catch (const nlopt::roundoff_limited&) {
      // The best point was kept.
    } catch (const std::exception& exception) {
      return fail("recalibration_failed", std::string("BOBYQA stopped: ") + exception.what());
    }
    return best;
  }

  /// Both stages of bins from `T_base`: 32 find the hill, 64 its top.
  [[nodiscard]] Result<RigidTransform> refine(const RigidTransform& T_base, const Eigen::Vector3d& pivot,
                                              int parameters) {
    const auto hill = maximise(T_base, pivot, parameters, 0.5, {.bins = 32});
    if (!hill) return hill;
    return maximise(*hill, pivot, parameters, 0.1, {.bins = 64});
  }

  [[nodiscard]] double limit(int axis) const { return axis < 3 ? bounds_.rotation_rad : bounds_.translation_m; }
  [[nodiscard]] int evaluations() const { return evaluations_; }

 private:
  Frames frames_;
  RigidTransform T_start_;
  SearchBounds bounds_;
  int evaluations_ = 0;
};

/// How much better `after` is than `before`, frame by frame: mean difference of the scores and its standard error.
struct Gain {
  double mean = 0, standard_error = 0;
  [[nodiscard]] bool exceeds(double sigmas) const { return mean > sigmas * standard_error && mean > 0; }
};
Gain gain(Frames frames, const RigidTransform& before, const RigidTransform& after) {
  std::vector<double> differences;
  Gain result;
  for (const FeatureSet* frame : frames) {
    differences.push_back(score(*frame, after).value - score(*frame, before).value);
    result.mean += differences.back();
  }
  const auto n = static_cast<double>(frames.size());
  result.mean /= n;
  double squares = 0;
  for (double difference : differences) squares += (difference - result.mean) * (difference - result.mean);
  result.standard_error = std::sqrt(squares / (n - 1) / n);
  return result;
}

/// Standard deviation of each parameter: the scatter of the frames' slopes at the optimum over its mean curvature. Where
/// the frames say nothing of an axis, what is known of it is the bounds.
Vector6 uncertainty(Frames frames, const RigidTransform& T, const SearchBounds& bounds) {
  DriftBaseline at_optimum;
  for (const FeatureSet* frame : frames) at_optimum.add(axis_evidence(evaluate_stencil(*frame, T), frame->stamp));
  Vector6 sigma;
  for (int axis = 0; axis < 6; ++axis) {
    sigma[axis] = axis < 3 ? bounds.rotation_rad : bounds.translation_m;
    if (at_optimum.observable(axis))
      sigma[axis] = std::min(sigma[axis], at_optimum.spread(axis) / -at_optimum.curvature[axis] /
                                              std::sqrt(static_cast<double>(frames.size())));
  }
  return sigma;
}

std::string in_words(const Gain& gained) {
  char text[96];
  std::snprintf(text, sizeof text, "score on pairs held back changes by %+.4f +- %.4f", gained.mean,
                gained.standard_error);
  return text;
}

}  // namespace

Result<Recalibration> recalibrate(Frames fit, Frames held_back,
                                  const RigidTransform& T_camera_lidar, const RecalibrationSettings& settings) {
  if (fit.size() < 3 || held_back.size() < 2)
    return fail("too_few_pairs", std::to_string(fit.size()) + " pairs to fit and " + std::to_string(held_back.size()) +
                                     " held back; at least 3 and 2 are needed");
  Search search(fit, T_camera_lidar, settings.bounds);
  const auto rotated = search.refine(search.coarse(), Eigen::Vector3d::Zero(), 3);
  if (!rotated) return tl::unexpected(rotated.error());
  const Eigen::Vector3d pivot = rotated->inverse() * Eigen::Vector3d(0, 0, pivot_distance_m);
  const auto moved = search.refine(*rotated, pivot, 6);
  if (!moved) return tl::unexpected(moved.error());

  Recalibration result;
  result.translation_changed = gain(held_back, *rotated, *moved).exceeds(settings.min_gain_sigmas);
  result.T_camera_lidar = result.translation_changed ? *moved : *rotated;
  result.delta = perturbation_parameters(T_camera_lidar.inverse() * result.T_camera_lidar);
  result.sigma = uncertainty(fit, result.T_camera_lidar, settings.bounds);
  result.score_before = mean_score(fit, T_camera_lidar).value;
  result.score_after = mean_score(fit, result.T_camera_lidar).value;
  result.held_back_before = mean_score(held_back, T_camera_lidar).value;
  result.held_back_after = mean_score(held_back, result.T_camera_lidar).value;
  result.evaluations = search.evaluations();

  for (int axis = 0; axis < 6; ++axis)
    if (std::abs(result.delta[axis]) > 0.98 * search.limit(axis)) {
      result.reason = "outside the bounds: " + std::string(axis_names[axis]) + " ends at its limit";
      return result;
    }
  if (result.delta.head<3>().norm() < settings.min_change_rotation_rad &&
      result.delta.tail<3>().norm() <= settings.min_change_translation_m) {
    result.reason = "the change is no larger than the depth source's own bias may be, and there is no sign of drift";
    return result;
  }
  const Gain gained = gain(held_back, T_camera_lidar, result.T_camera_lidar);
  result.accepted = gained.exceeds(settings.min_gain_sigmas);
  result.reason = (result.accepted ? "better on pairs held back: " : "not better on pairs held back: ") +
                  in_words(gained);
  return result;
}

}  // namespace calib
