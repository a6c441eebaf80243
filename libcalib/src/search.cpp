#include "calib/search.hpp"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <limits>
#include <nlopt.hpp>
#include <numbers>
#include <string>
#include <vector>

#include "rotation_grid.hpp"

namespace calib {
namespace {

constexpr double pivot_distance_m = 15;
/// Search variables are in these units, so that one unit matters about equally in each.
constexpr double rotation_unit_rad = radians_per_degree, translation_unit_m = 0.25;
constexpr int most_evaluations = 200;  // of one run of the optimiser

double unit_of(int axis) { return axis < 3 ? rotation_unit_rad : translation_unit_m; }

Objective objective_of(std::initializer_list<Term> terms, int stride = 1) {
  Objective objective{.terms = {}, .count = 0, .stride = stride};
  for (const Term& term : terms) objective.terms[objective.count++] = term;
  return objective;
}


bool all(const std::array<bool, 6>& released, int from, int to) {
  return std::all_of(released.begin() + from, released.begin() + to, [](bool axis) { return axis; });
}
bool any(const std::array<bool, 6>& released, int from, int to) {
  return std::any_of(released.begin() + from, released.begin() + to, [](bool axis) { return axis; });
}

/// The frames of a search. They are made anew about an estimate that is better than the one before.
class View {
 public:
  explicit View(Frames frames) : original_(frames), pointers_(frames.begin(), frames.end()) {}

  void look_about(const RigidTransform& T, const SearchBounds& bounds) {
    sets_.clear();
    for (const FeatureSet* frame : original_) sets_.push_back(frame->about(T, bounds));
    pointers_.clear();
    for (const FeatureSet& set : sets_) pointers_.push_back(&set);
  }
  [[nodiscard]] Frames frames() const { return pointers_; }
  /// At most `count` of them, evenly chosen.
  [[nodiscard]] std::vector<const FeatureSet*> some(std::size_t count) const {
    count = std::min(count, pointers_.size());
    std::vector<const FeatureSet*> chosen;
    for (std::size_t i = 0; i < count; ++i) chosen.push_back(pointers_[i * pointers_.size() / count]);
    return chosen;
  }

 private:
  Frames original_;
  std::vector<FeatureSet> sets_;
  std::vector<const FeatureSet*> pointers_;
};

/// What is maximised by a coarse look around: information in all that is in view, not per point, because a view with few
/// points left can score high by chance.
double total_information(Frames frames, const RigidTransform& T, const Objective& objective) {
  double sum = 0;
  for (const FeatureSet* frame : frames) {
    const Score one = score(*frame, T, objective);
    sum += (one.value - 1) * static_cast<double>(one.points);
  }
  return sum;
}

class Search {
 public:
  Search(Frames frames, const RigidTransform& T_start, const SearchSettings& settings)
      : view_(frames), T_start_(T_start), settings_(settings) {}

  View& view() { return view_; }

  /// The mean score less a penalty for leaving the bounds: they are a box in the LiDAR's own parameters, which is none in
  /// the search variables.
  [[nodiscard]] double value(const RigidTransform& T, const Objective& objective) {
    ++evaluations_;
    const Vector6 delta = delta_of(T);
    double outside = 0;
    for (int axis = settings_.any_orientation ? 3 : 0; axis < 6; ++axis)
      if (settings_.released[axis]) outside += std::max(0.0, std::abs(delta[axis]) / limit(axis) - 1);
    return mean_score(view_.frames(), T, objective).value - outside;
  }

  [[nodiscard]] Vector6 delta_of(const RigidTransform& T) const {
    return perturbation_parameters(T_start_.inverse() * T);
  }
  [[nodiscard]] double limit(int axis) const {
    return std::max(1e-9, axis < 3 ? settings_.bounds.rotation_rad : settings_.bounds.translation_m);
  }

  [[nodiscard]] Result<RigidTransform> coarse();
  [[nodiscard]] Result<RigidTransform> maximise(const RigidTransform& T_base, int parameters, double first_step,
                                                const Objective& objective, int budget = most_evaluations);
  [[nodiscard]] Result<RigidTransform> maximise_along(const RigidTransform& T_base, const Matrix6& directions,
                                                      const Objective& objective);
  [[nodiscard]] Matrix6 hill_directions(const RigidTransform& T, const Objective& objective);

  /// Again from where it ended, as long as that helps: BOBYQA's model of a narrow valley ends it early.
  [[nodiscard]] Result<RigidTransform> maximise_again(RigidTransform T, int parameters, double first_step,
                                                      const Objective& objective) {
    double last = value(T, objective);
    for (int i = 0; i < 3; ++i) {
      const auto better = maximise(T, parameters, first_step, objective);
      if (!better) return better;
      T = *better;
      const double now = value(T, objective);
      if (now - last < 1e-5) break;
      last = now;
    }
    return T;
  }

  /// 3 when rotation alone is sought, 6 for everything, 0 for any other choice of axes.
  [[nodiscard]] int parameters() const {
    if (!all(settings_.released, 0, 3)) return 0;
    return all(settings_.released, 3, 6) ? 6 : any(settings_.released, 3, 6) ? 0 : 3;
  }
  void tell(double share) const {
    if (settings_.progress) settings_.progress(share);
  }
  [[nodiscard]] int evaluations() const { return evaluations_; }
  [[nodiscard]] bool exhausted() const { return exhausted_; }

 private:
  [[nodiscard]] Result<void> optimise(std::vector<double> start, std::vector<double> lower, std::vector<double> upper,
                                      double first_step, int budget,
                                      const std::function<double(const std::vector<double>&)>& objective,
                                      double tolerance = 2e-3);
  View view_;
  RigidTransform T_start_;
  const SearchSettings& settings_;
  int evaluations_ = 0;
  bool exhausted_ = false;
};

/// The best of a grid of rotations, by few classes and few points. Its best places are followed uphill a little before
/// one of them is chosen.
Result<RigidTransform> Search::coarse() {
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
    const auto climbed = maximise(place.T, 3, 0.4 * spacing / rotation_unit_rad, hill, 60);
    if (!climbed) return climbed;
    place = {total_information(view_.frames(), *climbed, hill), *climbed};
  }
  return std::ranges::max_element(best, {}, &Place::value)->T;
}

Result<void> Search::optimise(std::vector<double> x, std::vector<double> lower, std::vector<double> upper,
                              double first_step, int budget,
                              const std::function<double(const std::vector<double>&)>& objective, double tolerance) {
  const auto inside = [&](const std::vector<double>& at) {  // BOBYQA may step a little over its bounds
    std::vector<double> clamped = at;
    for (std::size_t i = 0; i < at.size(); ++i) clamped[i] = std::clamp(at[i], lower[i], upper[i]);
    return objective(clamped);
  };
  using Inside = decltype(inside);
  try {
    nlopt::opt optimiser(nlopt::LN_BOBYQA, static_cast<unsigned>(x.size()));
    optimiser.set_lower_bounds(lower);
    optimiser.set_upper_bounds(upper);
    optimiser.set_initial_step(first_step);
    optimiser.set_xtol_abs(tolerance);
    optimiser.set_maxeval(budget);
    optimiser.set_max_objective(
        [](const std::vector<double>& at, std::vector<double>&, void* context) {
          return (*static_cast<const Inside*>(context))(at);
        },
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

/// Maximises from `T_base` over rotations about the LiDAR (`parameters` 3), over all six about a point ahead of the camera
/// (6), or over the released axes one by one (0). Returns the best extrinsic seen: where roundoff ends the search, NLopt's
/// last point is not always that.
Result<RigidTransform> Search::maximise(const RigidTransform& T_base, int parameters, double first_step,
                                        const Objective& objective, int budget) {
  const Eigen::Vector3d pivot =
      parameters == 6 ? Eigen::Vector3d(T_base.inverse() * Eigen::Vector3d(0, 0, pivot_distance_m)) : Eigen::Vector3d(0, 0, 0);
  std::vector<int> axes;
  std::vector<double> start, room, lower;
  const Vector6 from = parameters == 0 ? delta_of(T_base) : Vector6::Zero();
  for (int axis = 0; axis < 6; ++axis) {
    if (parameters == 0 ? !settings_.released[axis] : axis >= parameters) continue;
    axes.push_back(axis);
    start.push_back(from[axis] / unit_of(axis));
    // Turning about the pivot shifts the LiDAR, so its translation needs more room; `value` keeps the real bounds.
    const double more = axis < 3 ? 0 : pivot.norm() * std::min(limit(0), 0.2);
    room.push_back(parameters == 0 ? limit(axis) / unit_of(axis) : 2 * (limit(axis) + more) / unit_of(axis));
    if (axis < 3 && settings_.any_orientation) room.back() = 30;  // about a base that the grid gave
    lower.push_back(-room.back());
    start.back() = std::clamp(start.back(), lower.back(), room.back());
  }
  RigidTransform best = T_base;
  double best_value = value(T_base, objective);
  const auto at = [&](const std::vector<double>& x) {
    Vector6 delta = from;
    for (std::size_t i = 0; i < axes.size(); ++i) delta[axes[i]] = x[i] * unit_of(axes[i]);
    const RigidTransform T = parameters == 0 ? T_start_ * perturbation(delta) : T_base * perturbation_about(delta, pivot);
    const double result = value(T, objective);
    if (result > best_value) {
      best_value = result;
      best = T;
    }
    return result;
  };
  if (auto done = optimise(start, lower, room, first_step, budget, at); !done) return tl::unexpected(done.error());
  return best;
}

/// Turning about a point ahead of the camera, in the units of the search.
RigidTransform moved(const RigidTransform& T_base, const Vector6& units) {
  Vector6 delta;
  for (int axis = 0; axis < 6; ++axis) delta[axis] = units[axis] * unit_of(axis);
  return T_base * perturbation_about(delta, T_base.inverse() * Eigen::Vector3d(0, 0, pivot_distance_m));
}

/// Directions (columns) of the hill at `T`, each as long as it takes to lose the same small part of the score: along a
/// valley they are long, across it short. From second differences.
Matrix6 Search::hill_directions(const RigidTransform& T, const Objective& objective) {
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

/// Maximises all six along `directions`, again from where it ended as long as that helps. Where the hill is a valley, this
/// takes half as many evaluations as along the axes, and ends nearer to the top.
Result<RigidTransform> Search::maximise_along(const RigidTransform& T_base, const Matrix6& directions,
                                              const Objective& objective) {
  constexpr double room = 30, tolerance = 0.05, negligible = 1e-5;
  RigidTransform best = T_base;
  double best_value = value(T_base, objective);
  for (int pass = 0; pass < 3; ++pass) {
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
    if (auto done = optimise(std::vector<double>(6, 0.0), std::vector<double>(6, -room), std::vector<double>(6, room), 1,
                             most_evaluations, at, tolerance);
        !done)
      return tl::unexpected(done.error());
    if (best_value - before < negligible) break;
  }
  return best;
}

/// What may still be wrong with the estimate of the stages before.
SearchBounds still_open(const SearchSettings& settings, int parameters) {
  return {2 * radians_per_degree, parameters == 3 ? 0 : std::min(0.3, settings.bounds.translation_m)};
}

struct Optimum {
  RigidTransform T;
  Objective objective;
  bool depth_is_biased = false;
};

/// All six parameters from near the optimum. Tiles say whether the depth is biased across the image: the rotation that
/// they alone would choose is then another one. Depth of the whole image counts for little in that case.
Result<Optimum> finish_six(Search& search, const RigidTransform& T_near) {
  constexpr double same_rotation_rad = 0.1 * radians_per_degree;
  const Objective whole = final_objective(Method::standard, {true, true, true, true, true, true});
  const Matrix6 directions = search.hill_directions(T_near, objective_of({{.ranks_per_class = 8}}));
  const auto found = search.maximise_along(T_near, directions, whole);
  if (!found) return tl::unexpected(found.error());
  const auto by_tiles =
      search.maximise(*found, 3, 0.3, final_objective(Method::standard, {true, true, true, false, false, false}), 25);
  if (!by_tiles) return tl::unexpected(by_tiles.error());
  if (rotation_angle_rad(found->inverse() * *by_tiles) < same_rotation_rad) return Optimum{*found, whole};
  Objective distrustful = whole;
  distrustful.terms[0].weight = 0.1;
  const auto again = search.maximise_along(*by_tiles, directions, distrustful);
  if (!again) return tl::unexpected(again.error());
  return Optimum{*again, distrustful, true};
}

Result<Optimum> search_standard(Search& search, const RigidTransform& T_start, const SearchSettings& settings) {
  const int parameters = search.parameters();
  RigidTransform T = T_start;
  SearchBounds bounds = settings.bounds;
  if (settings.any_orientation) bounds.rotation_rad = std::numbers::pi;
  search.view().look_about(T, bounds);
  if (parameters != 0 && (settings.any_orientation || settings.bounds.rotation_rad > 2.5 * radians_per_degree)) {
    const auto found = search.coarse();
    if (!found) return tl::unexpected(found.error());
    T = *found;
    search.view().look_about(T, {15 * radians_per_degree, settings.bounds.translation_m});
  }
  for (const int stage : parameters == 6 ? std::vector<int>{3, 6} : std::vector<int>{parameters}) {
    const Objective hill = objective_of({{.ranks_per_class = 8}}, stage == 6 ? 1 : 4);  // translation needs every point
    const auto better = search.maximise(T, stage, 0.7, hill);
    if (!better) return tl::unexpected(better.error());
    T = *better;
    search.tell(stage == parameters ? 0.7 : 0.6);
  }
  search.view().look_about(T, still_open(settings, parameters));
  if (parameters == 6) return finish_six(search, T);
  const Objective top = final_objective(Method::standard, settings.released);
  const auto found = search.maximise_again(T, parameters, 0.3, top);
  if (!found) return tl::unexpected(found.error());
  return Optimum{*found, top};
}

/// As the paper does it: the six parameters themselves, from the start, with the optimiser's usual first step of a quarter
/// of the room.
Result<Optimum> search_as_published(Search& search, const RigidTransform& T_start, Method method,
                                    const SearchSettings& settings) {
  double first_step = std::numeric_limits<double>::infinity();
  for (int axis = 0; axis < 6; ++axis)
    if (settings.released[axis]) first_step = std::min(first_step, search.limit(axis) / unit_of(axis) / 4);
  const Objective top = final_objective(method, settings.released);
  if (method != Method::i2i_nmi) {
    const auto found = search.maximise(T_start, 0, first_step, top);
    if (!found) return tl::unexpected(found.error());
    return Optimum{*found, top};
  }
  const Objective hill = objective_of({{FeaturePair::intensity, 1, 8, true}});
  const auto near = search.maximise(T_start, 0, first_step, hill);
  if (!near) return tl::unexpected(near.error());
  const auto found = search.maximise_again(*near, 0, std::min(first_step, 0.3), top);
  if (!found) return tl::unexpected(found.error());
  return Optimum{*found, top};
}

}  // namespace

Objective final_objective(Method method, const std::array<bool, 6>& released) {
  using enum FeaturePair;
  switch (method) {
    case Method::d2d: return objective_of({{linear_depth, 1, 1, false}});
    case Method::i2i: return objective_of({{linear_intensity, 1, 1, false}});
    case Method::i2i_nmi: return objective_of({{intensity, 1, 4, true}});
    case Method::standard: break;
  }
  // Tiles keep a bias of the depth out of the rotation. They also flatten the valley in which pitch trades against z, so
  // that where translation is sought, depth of the whole image has its say.
  if (!any(released, 3, 6)) return objective_of({{tiled_depth, 1, 8, true}, {intensity, 3, 8, true}});
  return objective_of({{depth, 1, 4, true}, {tiled_depth, 1, 8, true}, {intensity, 6, 8, true}});
}

Result<SearchResult> search(Frames frames, const RigidTransform& T_camera_lidar, Method method,
                            const SearchSettings& settings) {
  if (frames.empty()) return fail("too_few_pairs", "there is no frame to search with");
  if (!any(settings.released, 0, 6)) return fail("search_failed", "no axis is released");
  if (!T_camera_lidar.matrix().allFinite()) return fail("search_failed", "the extrinsic is not a number");
  Search search(frames, T_camera_lidar, settings);
  const auto found = method == Method::standard ? search_standard(search, T_camera_lidar, settings)
                                                : search_as_published(search, T_camera_lidar, method, settings);
  if (!found) return tl::unexpected(found.error());

  SearchResult result;
  result.T_camera_lidar = found->T;
  result.delta = search.delta_of(found->T);
  result.objective = found->objective;
  result.depth_is_biased = found->depth_is_biased;
  const Score before = mean_score(search.view().frames(), T_camera_lidar, found->objective);
  const Score after = mean_score(search.view().frames(), found->T, found->objective);
  if (after.points < min_scored_points)
    return fail("search_failed", "hardly a LiDAR point is in view; do camera and LiDAR look the same way?");
  result.score_before = before.value;
  result.score_after = after.value;
  result.evaluations = search.evaluations();
  result.reason = search.exhausted() ? "the optimiser's last run was cut short" : "converged";
  for (int axis = settings.any_orientation ? 3 : 0; axis < 6; ++axis)
    if (settings.released[axis] && std::abs(result.delta[axis]) > 0.98 * search.limit(axis)) {
      result.reason = "ends at the limit of " + std::string(axis_names[axis]);
      result.ends_at_limit = true;
    }
  search.tell(1);
  return result;
}

Result<Method> parse_method(std::string_view name) {
  for (const Method method : {Method::standard, Method::d2d, Method::i2i, Method::i2i_nmi})
    if (name == to_string(method)) return method;
  return fail("unknown_objective",
              "objective '" + escape_control(name) + "' is not known; there are default, d2d, i2i and i2i_nmi");
}

std::string_view to_string(Method method) {
  switch (method) {
    case Method::d2d: return "d2d";
    case Method::i2i: return "i2i";
    case Method::i2i_nmi: return "i2i_nmi";
    case Method::standard: break;
  }
  return "default";
}

bool needs_linear_features(Method method) { return method == Method::d2d || method == Method::i2i; }

}  // namespace calib
