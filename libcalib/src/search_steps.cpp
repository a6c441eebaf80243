#include "search_steps.hpp"

#include <Eigen/Eigenvalues>
#include <cmath>
#include <limits>
#include <nlopt.hpp>
#include <numbers>
#include <string>

#include "quadratic_model.hpp"
#include "rotation_grid.hpp"

namespace calib {
namespace {

constexpr double negligible_gain = 1e-5;

bool all(const std::array<bool, 6>& free_axes, int from, int to) {
  return std::all_of(free_axes.begin() + from, free_axes.begin() + to, [](bool axis) { return axis; });
}

/// Objective of the coarse grid search: the information of all points in view, not per point, because a view with few
/// points can score high by chance.
std::vector<double> total_information(Frames frames, std::span<const RigidTransform> T, const Objective& objective,
                                      const std::function<bool()>& cancelled) {
  std::vector<double> sums(T.size());
  for (const FeatureSet* frame : frames) {
    if (cancelled()) break;
    for (std::size_t i = 0; i < T.size(); ++i) {
      const Score one = score(*frame, T[i], objective);
      sums[i] += (one.value - 1) * static_cast<double>(one.points);
    }
  }
  return sums;
}

/// A rotation about a point ahead of the camera and a translation, in the units of the search.
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

std::vector<double> SearchSteps::values(std::span<const RigidTransform> T, const Objective& objective) {
  evaluations_ += static_cast<int>(T.size());
  std::vector<double> values;
  if (cancelled()) return std::vector<double>(T.size());
  for (const Score& score : mean_scores(view_.frames(), T, objective)) values.push_back(score.value);
  for (std::size_t i = 0; i < T.size(); ++i) {
    const Vector6 delta = delta_of(T[i]);
    for (int axis = settings_.any_orientation ? 3 : 0; axis < 6; ++axis)
      if (settings_.free_axes[axis]) values[i] -= std::max(0.0, std::abs(delta[axis]) / limit(axis) - 1);
  }
  return values;
}

int SearchSteps::parameters() const {
  if (!all(settings_.free_axes, 0, 3)) return 0;
  if (all(settings_.free_axes, 3, 6)) return 6;
  return std::none_of(settings_.free_axes.begin() + 3, settings_.free_axes.end(), [](bool axis) { return axis; }) ? 3
                                                                                                                  : 0;
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

std::vector<RigidTransform> SearchSteps::best_of_grid(const RigidTransform& T_base, double reach_rad,
                                                      double spacing_rad, const Objective& objective,
                                                      std::size_t count) {
  const bool everywhere = reach_rad > std::numbers::pi / 3;
  const auto grid =
      everywhere ? rotations_everywhere(reach_rad, spacing_rad) : rotations_within(reach_rad, spacing_rad);
  const auto few = view_.some(everywhere ? 8 : 25);
  struct Candidate {
    double value;
    RigidTransform T;
  };
  std::vector<Candidate> candidates;
  constexpr std::size_t at_once = 512;
  for (std::size_t first = 0; first < grid.size(); first += at_once) {
    std::vector<RigidTransform> some;
    for (std::size_t i = first; i < std::min(grid.size(), first + at_once); ++i)
      some.push_back(T_base * RigidTransform(grid[i]));
    const std::vector<double> information = total_information(few, some, objective, [this] { return cancelled(); });
    for (std::size_t i = 0; i < some.size(); ++i) candidates.push_back({information[i], some[i]});
    report_progress(0.5 * static_cast<double>(first) / static_cast<double>(grid.size()));
  }
  evaluations_ += static_cast<int>(grid.size());
  std::ranges::stable_sort(candidates, std::ranges::greater(), &Candidate::value);

  std::vector<RigidTransform> best;
  for (const Candidate& candidate : candidates) {
    const auto near = [&](const RigidTransform& other) {
      return rotation_angle_rad(candidate.T.inverse() * other) < 1.5 * spacing_rad;
    };
    if (std::ranges::none_of(best, near)) best.push_back(candidate.T);
    if (best.size() == count) break;
  }
  return best;
}

Result<RigidTransform> SearchSteps::coarse() {
  constexpr double wide_rad = 6 * radians_per_degree;
  const double reach = settings_.any_orientation ? std::numbers::pi : settings_.bounds.rotation_rad;
  const double spacing = std::clamp(reach / 5, 1.5 * radians_per_degree, 7.5 * radians_per_degree);
  const bool wide = reach > wide_rad;
  const auto candidates = best_of_grid(T_start_, reach, spacing, objective_of({{.ranks_per_class = 16}}, wide ? 32 : 8),
                                       !wide                          ? 1
                                       : reach > std::numbers::pi / 3 ? 16
                                                                      : 6);
  if (candidates.size() == 1) return candidates.front();
  const Objective middle = objective_of({{.ranks_per_class = 8}}, 8);
  RigidTransform best = T_start_;
  double most = -std::numeric_limits<double>::infinity();
  for (const RigidTransform& candidate : candidates) {
    const auto climbed = maximise(candidate, 3, 0.4 * spacing / unit_of(0), middle, 60);
    if (!climbed) return climbed;
    const double information =
        total_information(view_.frames(), {&*climbed, 1}, middle, [this] { return cancelled(); }).front();
    if (information > most) best = *climbed, most = information;
  }
  return best;
}

Result<void> SearchSteps::optimise(std::vector<double> x, const std::vector<double>& bounds, const Run& run,
                                   const std::function<double(const std::vector<double>&)>& objective) {
  const auto inside = [&](const std::vector<double>& at) {  // BOBYQA may step a little over its bounds
    std::vector<double> clamped = at;
    for (std::size_t i = 0; i < at.size(); ++i) clamped[i] = std::clamp(at[i], -bounds[i], bounds[i]);
    return objective(clamped);
  };
  using Inside = decltype(inside);
  try {
    nlopt::opt optimiser(nlopt::LN_BOBYQA, static_cast<unsigned>(x.size()));
    std::vector<double> lower = bounds;
    for (double& side : lower) side = -side;
    optimiser.set_lower_bounds(lower);
    optimiser.set_upper_bounds(bounds);
    // A first step that does not fit between the bounds is an error to NLopt.
    optimiser.set_initial_step(std::min(run.first_step, std::ranges::min(bounds)));
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
    return fail(ErrorCode::search_failed, std::string("BOBYQA stopped: ") + exception.what());
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
    if (parameters == 0 ? !settings_.free_axes[axis] : axis >= parameters) continue;
    axes.push_back(axis);
    start.push_back(from[axis] / unit_of(axis));
    // A rotation about the pivot shifts the LiDAR, so its translation needs wider bounds; `value` keeps the real ones.
    const double more = axis < 3 ? 0 : pivot.norm() * std::min(limit(0), 0.2) / unit_of(axis);
    bounds.push_back(parameters == 0 ? bound(axis) : 2 * (bound(axis) + more));
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
    return propagate(done);
  return best;
}

Matrix6 SearchSteps::principal_axes(const RigidTransform& T, const Objective& objective) {
  constexpr double step = 0.35, same_loss = 3e-4, longest = 1.5;
  std::vector<RigidTransform> extrinsics{T};
  const auto add = [&](const Vector6& units) {
    extrinsics.push_back(moved(T, units));
    extrinsics.push_back(moved(T, -units));
  };
  for (int i = 0; i < 6; ++i) {
    add(step * Vector6::Unit(i));
    for (int j = 0; j < i; ++j) add(step * (Vector6::Unit(i) + Vector6::Unit(j)));
  }
  const std::vector<double> at = values(extrinsics, objective);
  // Second differences: the loss on both sides together.
  Matrix6 curvature;
  std::size_t next = 1;
  const auto lost = [&] {
    next += 2;
    return (2 * at[0] - at[next - 2] - at[next - 1]) / (step * step);
  };
  for (int i = 0; i < 6; ++i) {
    curvature(i, i) = lost();
    for (int j = 0; j < i; ++j) curvature(i, j) = curvature(j, i) = (lost() - curvature(i, i) - curvature(j, j)) / 2;
  }
  const Eigen::SelfAdjointEigenSolver<Matrix6> axes(curvature);
  const double flattest = 2 * same_loss / (longest * longest);
  const Vector6 length = (2 * same_loss * axes.eigenvalues().cwiseMax(flattest).cwiseInverse()).cwiseSqrt();
  return axes.eigenvectors() * length.asDiagonal();
}

Result<RigidTransform> SearchSteps::climb(int parameters, const Parametrisation& to_extrinsic,
                                          const Objective& objective, const Climb& how) {
  constexpr double least_radius = 0.3, longest_step = 2;  // the latter in radii
  QuadraticModel model(parameters);
  Eigen::VectorXd centre = Eigen::VectorXd::Zero(parameters);
  double radius = how.radius;
  bool in_reach = false;
  for (int batch = 0; batch < how.batches || (!in_reach && batch == how.batches); ++batch) {
    const Eigen::MatrixXd axes = radius * turned_axes(parameters, batch);
    std::vector<Eigen::VectorXd> at{centre};
    for (int i = 0; i < parameters; ++i) {
      at.emplace_back(centre + axes.col(i));
      at.emplace_back(centre - axes.col(i));
    }
    const double best_before = model.best().value;
    std::vector<RigidTransform> extrinsics;
    std::ranges::transform(at, std::back_inserter(extrinsics), to_extrinsic);
    const std::vector<double> found = values(extrinsics, objective);
    for (std::size_t i = 0; i < at.size(); ++i) model.add({at[i], found[i]});
    double loss = 0;
    for (std::size_t i = 1; i < found.size(); ++i) loss += std::max(0.0, found[0] - found[i]) / parameters;
    if (batch > 0 && found[0] < best_before) radius = std::max(least_radius, radius / 2);
    const Eigen::VectorXd step = model.step_to_maximum(radius, loss, longest_step);
    centre = model.best().at + step;
    in_reach = step.norm() < radius;
    if (in_reach) radius = std::max(least_radius, radius / 1.5);
  }
  if (value(to_extrinsic(centre), objective) < model.best().value) centre = model.best().at;
  if (!in_reach && how.to_the_maximum) return follow_valley(to_extrinsic, centre, objective);
  exhausted_ = !in_reach;
  return to_extrinsic(centre);
}

Result<RigidTransform> SearchSteps::follow_valley(const Parametrisation& to_extrinsic, Eigen::VectorXd best,
                                                  const Objective& objective) {
  const auto parameters = static_cast<std::size_t>(best.size());
  const std::vector<double> bounds(parameters, 30);
  double best_value = value(to_extrinsic(best), objective);
  // The second pass takes wide steps, across the local maxima of a flat valley.
  for (const double first_step : {1.0, 3.0, 1.0}) {
    const Eigen::VectorXd centre = best;
    const double before = best_value;
    const auto at = [&](const std::vector<double>& x) {
      const Eigen::VectorXd there = centre + Eigen::Map<const Eigen::VectorXd>(x.data(), centre.size());
      const double result = value(to_extrinsic(there), objective);
      if (result > best_value) {
        best_value = result;
        best = there;
      }
      return result;
    };
    if (auto done =
            optimise(std::vector<double>(parameters, 0), bounds, {.first_step = first_step, .tolerance = 0.05}, at);
        !done)
      return propagate(done);
    if (first_step > 1 && best_value - before < negligible_gain) break;
  }
  return to_extrinsic(best);
}

Result<RigidTransform> SearchSteps::climb_along(const RigidTransform& T_base, const Matrix6& directions,
                                                const Objective& objective, const Climb& how) {
  return climb(
      6, [&](const Eigen::VectorXd& x) { return moved(T_base, directions * x); }, objective, how);
}

}  // namespace calib
