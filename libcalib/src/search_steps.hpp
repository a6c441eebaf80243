#pragma once

#include <algorithm>
#include <functional>
#include <initializer_list>
#include <span>
#include <vector>

#include "calib/search.hpp"

namespace calib {

constexpr int most_evaluations = 200;    // of one run of the optimiser
constexpr double pivot_distance_m = 15;  // ahead of the camera, amid the scene

/// Search variables are in these units (a degree, 25 cm), so that one unit matters about equally in each.
[[nodiscard]] double unit_of(int axis);

[[nodiscard]] Objective objective_of(std::initializer_list<Term> terms, int stride = 1);

/// The frames of a search, culled to the points that can be in view. They are culled again about each better estimate.
class View {
 public:
  explicit View(Frames frames) : original_(frames), pointers_(frames.begin(), frames.end()) {}

  /// Changes nothing when `cancelled` returns true before the end.
  void recull(const RigidTransform& T, const SearchBounds& bounds, const std::function<bool()>& cancelled) {
    std::vector<FeatureSet> sets;
    for (const FeatureSet* frame : original_) {
      if (cancelled()) return;
      sets.push_back(frame->about(T, bounds));
    }
    sets_ = std::move(sets);
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

/// The steps of a search.
class SearchSteps {
 public:
  SearchSteps(Frames frames, const RigidTransform& T_start, const SearchSettings& settings)
      : view_(frames), T_start_(T_start), settings_(settings) {}

  void recull(const RigidTransform& T, const SearchBounds& bounds) {
    view_.recull(T, bounds, [this] { return cancelled(); });
  }
  /// Polls `keep_going`. Once it has returned false all scores are zero at no cost, so that every step ends soon.
  [[nodiscard]] bool cancelled() {
    return cancelled_ = cancelled_ || (settings_.keep_going && !settings_.keep_going());
  }

  /// The mean score less a penalty outside the bounds: they are a box in the LiDAR's parameters, not in the search
  /// variables.
  [[nodiscard]] double value(const RigidTransform& T, const Objective& objective) {
    return values({&T, 1}, objective).front();
  }
  /// At several extrinsics, in less time than one by one.
  [[nodiscard]] std::vector<double> values(std::span<const RigidTransform> T, const Objective& objective);

  [[nodiscard]] Vector6 delta_of(const RigidTransform& T) const {
    return perturbation_parameters(T_start_.inverse() * T);
  }
  [[nodiscard]] double limit(int axis) const {
    return std::max(1e-9, axis < 3 ? settings_.bounds.rotation_rad : settings_.bounds.translation_m);
  }

  /// Bound of the axis in units; with any orientation, about a candidate of the grid.
  [[nodiscard]] double bound(int axis) const {
    return axis < 3 && settings_.any_orientation ? 30 : limit(axis) / unit_of(axis);
  }

  /// The extrinsics that score best in a grid of rotations about `T_base`, at most `count`, none next to another.
  [[nodiscard]] std::vector<RigidTransform> best_of_grid(const RigidTransform& T_base, double reach_rad,
                                                         double spacing_rad, const Objective& objective,
                                                         std::size_t count);
  /// Coarse grid search over rotations, by few classes and few points. The best candidates are refined a little before
  /// one of them is chosen.
  [[nodiscard]] Result<RigidTransform> coarse();

  /// Maximises from `T_base` over rotations about the LiDAR (`parameters` 3), over all six about a point ahead of the
  /// camera (6), or over the free axes (0). Returns the best extrinsic evaluated: where roundoff ends the search,
  /// NLopt's last point is not always that.
  [[nodiscard]] Result<RigidTransform> maximise(const RigidTransform& T_base, int parameters, double first_step,
                                                const Objective& objective, int budget = most_evaluations);
  /// Restarts from the result as long as that helps: in a narrow valley BOBYQA ends early.
  [[nodiscard]] Result<RigidTransform> maximise_again(RigidTransform T, int parameters, double first_step,
                                                      const Objective& objective);

  /// Principal axes (columns) of the curvature at `T`, scaled so that a step along each loses the same small part of
  /// the score. From second differences.
  [[nodiscard]] Matrix6 principal_axes(const RigidTransform& T, const Objective& objective);
  using Parametrisation = std::function<RigidTransform(const Eigen::VectorXd&)>;
  struct Climb {
    double radius = 1;           // of the first batch
    int batches = 3;             // and one more when the maximum is not within reach by then
    bool to_the_maximum = true;  // BOBYQA continues when it still is not
  };
  /// Maximises from zero over parameters that are scaled so that one unit of each loses about as much of the score: by
  /// quadratics fitted to batches of samples, each about the maximum of the one before. Near the maximum this takes
  /// fewer evaluations than BOBYQA and ends nearer to it, because a fit averages out local maxima. Returns the best
  /// extrinsic evaluated.
  [[nodiscard]] Result<RigidTransform> climb(int parameters, const Parametrisation& to_extrinsic,
                                             const Objective& objective, const Climb& how);
  /// All six, along `directions`.
  [[nodiscard]] Result<RigidTransform> climb_along(const RigidTransform& T_base, const Matrix6& directions,
                                                   const Objective& objective, const Climb& how);

  /// 3 when only the rotation is free, 6 when all axes are, 0 for any other choice of axes.
  [[nodiscard]] int parameters() const;
  void report_progress(double share) const {
    if (settings_.progress) settings_.progress(share);
  }
  [[nodiscard]] int evaluations() const { return evaluations_; }
  [[nodiscard]] bool exhausted() const { return exhausted_; }

 private:
  /// By BOBYQA, restarted from its result as long as that helps.
  [[nodiscard]] Result<RigidTransform> follow_valley(const Parametrisation& to_extrinsic, Eigen::VectorXd start,
                                                     const Objective& objective);
  struct Run {
    double first_step = 1, tolerance = 2e-3;
    int budget = most_evaluations;
  };
  /// One run of BOBYQA from `x`, within `bounds` to either side of zero.
  [[nodiscard]] Result<void> optimise(std::vector<double> x, const std::vector<double>& bounds, const Run& run,
                                      const std::function<double(const std::vector<double>&)>& objective);

  View view_;
  RigidTransform T_start_;
  const SearchSettings& settings_;
  int evaluations_ = 0;
  bool exhausted_ = false;
  bool cancelled_ = false;
};

}  // namespace calib
