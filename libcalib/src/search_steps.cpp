#include "search_steps.hpp"

#include <Eigen/Eigenvalues>
#include <cmath>
#include <nlopt.hpp>
#include <numbers>
#include <string>

#include "rotation_grid.hpp"

namespace calib {
namespace {

constexpr double negligible_gain = 1e-5;

bool all(const std::array<bool, 6>& released, int from, int to) {
  return std::all_of(released.begin() + from, released.begin() + to, [](bool axis) { return axis; });
}

/// What is maximised by a coarse look around: information in all that is in view, not per point, because a view with
/// few points left can score high by chance.
double total_information(Frames frames, const RigidTransform& T, const Objective& objective) {
  double sum = 0;
  for (const FeatureSet* frame : frames) {
    const Score one = score(*frame, T, objective);
    sum += (one.value - 1) * static_cast<double>(one.points);
  }
  return sum;
}

/// Turning about a point ahead of the camera, in the units of the search.
RigidTransform moved(const RigidTransform& T_base, const Vector6& units) {
  Vector6 delta;
  for (int axis = 0; axis < 6; ++axis) delta[axis] = units[axis] * unit_of(axis);
  return T_base * perturbation_about(delta, T_base.inverse() * Eigen::Vector3d(0, 0, pivot_distance_m));
}

}  // namespace

double unit_of(int axis) { return axis < 3 ? radians_per_degree : 0.25; }

Objective objective_of(std::initializer_list<Term> terms, int stride) {
  Objective objective{.terms = {}, .count = 0, .stride = stride};
  for (const Term& term : terms) objective.terms[objective.count++] = term;
  return objective;
}

double SearchSteps::value(const RigidTransform& T, const Objective& objective) {
  ++evaluations_;
  const Vector6 delta = delta_of(T);
  double outside = 0;
  for (int axis = settings_.any_orientation ? 3 : 0; axis < 6; ++axis)
    if (settings_.released[axis]) outside += std::max(0.0, std::abs(delta[axis]) / limit(axis) - 1);
  return mean_score(view_.frames(), T, objective).value - outside;
}

int SearchSteps::parameters() const {
  if (!all(settings_.released, 0, 3)) return 0;
  if (all(settings_.released, 3, 6)) return 6;
  return std::none_of(settings_.released.begin() + 3, settings_.released.end(), [](bool axis) { return axis; }) ? 3 : 0;
}

Result<RigidTransform> SearchSteps::maximise_again(RigidTransform T, int parameters, double first_step,
                                                   const Objective& objective) {
  double last = value(T, objective);
  for (int pass = 0; pass < 3; ++pass) {
    const auto better = maximise(T, parameters, first_step, objective);
    if (!better) return better;
    T = *better;
    const double now = value(T, objective);
    if (now - last < negligible_gain) break;
    last = now;
  }
  return T;
}

Result<RigidTransform> SearchSteps::coarse() {
  constexpr double wide_rad = 6 * radians_per_degree;
  const double reach = settings_.any_orientation ? std::numbers::pi : settings_.bounds.rotation_rad;
  const double spacing = std::clamp(reach / 5, 1.5 * radians_per_degree, 7.5 * radians_per_degree);
  const auto grid =
      reach > std::numbers::pi / 3 ? rotations_everywhere(reach, spacing) : rotations_within(reach, spacing);
  const bool wide = reach > wide_rad;
  const auto few = view_.some(reach > std::numbers::pi / 3 ? 8 : 25);
  const Objective quick = objective_of({{.ranks_per_class = 16}}, wide ? 32 : 8);
  struct Place {
    double value;
    RigidTransform T;
  };
  std::vector<Place> places;
  for (std::size_t i = 0; i < grid.size(); ++i) {
    const RigidTransform T = T_start_ * RigidTransform(grid[i]);
    places.push_back({total_information(few, T, quick), T});
    if (i % 512 == 0) tell(0.5 * static_cast<double>(i) / static_cast<double>(grid.size()));
  }
  evaluations_ += static_cast<int>(grid.size());
  std::ranges::stable_sort(places, std::ranges::greater(), &Place::value);

  const std::size_t wanted = !wide ? 1 : reach > std::numbers::pi / 3 ? 16 : 6;
  std::vector<Place> best;
  for (const Place& place : places) {
    const auto near = [&](const Place& other) {
      return rotation_angle_rad(place.T.inverse() * other.T) < 1.5 * spacing;
    };
    if (!std::ranges::any_of(best, near)) best.push_back(place);
    if (best.size() == wanted) break;
  }
  if (best.size() == 1) return best.front().T;
  const Objective hill = objective_of({{.ranks_per_class = 8}}, 8);
  for (Place& place : best) {
    const auto climbed = maximise(place.T, 3, 0.4 * spacing / unit_of(0), hill, 60);
    if (!climbed) return climbed;
    place = {total_information(view_.frames(), *climbed, hill), *climbed};
  }
  return std::ranges::max_element(best, {}, &Place::value)->T;
}

Result<void> SearchSteps::optimise(std::vector<double> x, const std::vector<double>& room, const Run& run,
                                   const std::function<double(const std::vector<double>&)>& objective) {
  const auto inside = [&](const std::vector<double>& at) {  // BOBYQA may step a little over its bounds
    std::vector<double> clamped = at;
    for (std::size_t i = 0; i < at.size(); ++i) clamped[i] = std::clamp(at[i], -room[i], room[i]);
    return objective(clamped);
  };
  using Inside = decltype(inside);
  try {
    nlopt::opt optimiser(nlopt::LN_BOBYQA, static_cast<unsigned>(x.size()));
    std::vector<double> lower = room;
    for (double& bound : lower) bound = -bound;
    optimiser.set_lower_bounds(lower);
    optimiser.set_upper_bounds(room);
    // A first step that does not fit between the bounds is an error to NLopt.
    optimiser.set_initial_step(std::min(run.first_step, std::ranges::min(room)));
    optimiser.set_xtol_abs(run.tolerance);
    optimiser.set_maxeval(run.budget);
    optimiser.set_max_objective([](const std::vector<double>& at, std::vector<double>&,
                                   void* context) { return (*static_cast<const Inside*>(context))(at); },
                                const_cast<void*>(static_cast<const void*>(&inside)));
    double last_value = 0;
    exhausted_ = optimiser.optimize(x, last_value) == nlopt::MAXEVAL_REACHED;
  } catch (const nlopt::roundoff_limited&) {
    exhausted_ = false;  // as near as arithmetic allows
  } catch (const std::exception& exception) {
    return fail("search_failed", std::string("BOBYQA stopped: ") + exception.what());
  }
  return {};
}

Result<RigidTransform> SearchSteps::maximise(const RigidTransform& T_base, int parameters, double first_step,
                                             const Objective& objective, int budget) {
  const Eigen::Vector3d pivot = parameters == 6
                                    ? Eigen::Vector3d(T_base.inverse() * Eigen::Vector3d(0, 0, pivot_distance_m))
                                    : Eigen::Vector3d(0, 0, 0);
  std::vector<int> axes;
  std::vector<double> start, bounds;
  const Vector6 from = parameters == 0 ? delta_of(T_base) : Vector6::Zero();
  for (int axis = 0; axis < 6; ++axis) {
    if (parameters == 0 ? !settings_.released[axis] : axis >= parameters) continue;
    axes.push_back(axis);
    start.push_back(from[axis] / unit_of(axis));
    // Turning about the pivot shifts the LiDAR, so its translation needs more room; `value` keeps the real bounds.
    const double more = axis < 3 ? 0 : pivot.norm() * std::min(limit(0), 0.2) / unit_of(axis);
    bounds.push_back(parameters == 0 ? room(axis) : 2 * (room(axis) + more));
    start.back() = std::clamp(start.back(), -bounds.back(), bounds.back());
  }
  RigidTransform best = T_base;
  double best_value = value(T_base, objective);
  const auto at = [&](const std::vector<double>& x) {
    Vector6 delta = from;
    for (std::size_t i = 0; i < axes.size(); ++i) delta[axes[i]] = x[i] * unit_of(axes[i]);
    const RigidTransform T =
        parameters == 0 ? T_start_ * perturbation(delta) : T_base * perturbation_about(delta, pivot);
    const double result = value(T, objective);
    if (result > best_value) {
      best_value = result;
      best = T;
    }
    return result;
  };
  if (auto done = optimise(start, bounds, {.first_step = first_step, .budget = budget}, at); !done)
    return tl::unexpected(done.error());
  return best;
}

Matrix6 SearchSteps::hill_directions(const RigidTransform& T, const Objective& objective) {
  constexpr double step = 0.35, same_loss = 3e-4, longest = 1.5;
  const auto at = [&](const Vector6& units) { return value(moved(T, units), objective); };
  const double here = at(Vector6::Zero());
  Vector6 plus, minus;
  Matrix6 curvature;
  for (int i = 0; i < 6; ++i) {
    const Vector6 move = step * Vector6::Unit(i);
    plus[i] = at(move);
    minus[i] = at(-move);
    curvature(i, i) = (2 * here - plus[i] - minus[i]) / (step * step);
    for (int j = 0; j < i; ++j) {
      const Vector6 both = move + step * Vector6::Unit(j);
      curvature(i, j) = (plus[i] + minus[i] + plus[j] + minus[j] - 2 * here - at(both) - at(-both)) / (2 * step * step);
      curvature(j, i) = curvature(i, j);
    }
  }
  const Eigen::SelfAdjointEigenSolver<Matrix6> hill(curvature);
  const double flattest = 2 * same_loss / (longest * longest);
  const Vector6 length = (2 * same_loss * hill.eigenvalues().cwiseMax(flattest).cwiseInverse()).cwiseSqrt();
  return hill.eigenvectors() * length.asDiagonal();
}

Result<RigidTransform> SearchSteps::maximise_along(const RigidTransform& T_base, const Matrix6& directions,
                                                   const Objective& objective) {
  const std::vector<double> room(6, 30);
  RigidTransform best = T_base;
  double best_value = value(T_base, objective);
  // The second pass takes wide steps, over the small hills that a flat valley is full of.
  for (const double first_step : {1.0, 3.0, 1.0}) {
    const RigidTransform T_centre = best;
    const double before = best_value;
    const auto at = [&](const std::vector<double>& x) {
      const RigidTransform T = moved(T_centre, directions * Eigen::Map<const Vector6>(x.data()));
      const double result = value(T, objective);
      if (result > best_value) {
        best_value = result;
        best = T;
      }
      return result;
    };
    if (auto done = optimise(std::vector<double>(6, 0.0), room, {.first_step = first_step, .tolerance = 0.05}, at);
        !done)
      return tl::unexpected(done.error());
    if (first_step > 1 && best_value - before < negligible_gain) break;
  }
  return best;
}

}  // namespace calib
