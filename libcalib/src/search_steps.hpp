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

/// The frames of a search. They are made anew about an estimate that is better than the one before.
class View {
 public:
  explicit View(Frames frames) : original_(frames), pointers_(frames.begin(), frames.end()) {}

  /// Nothing happens when `cancelled` says so before it is done.
  void look_about(const RigidTransform& T, const SearchBounds& bounds, const std::function<bool()>& cancelled) {
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

/// The steps that searches are made of.
class SearchSteps {
 public:
  SearchSteps(Frames frames, const RigidTransform& T_start, const SearchSettings& settings)
      : view_(frames), T_start_(T_start), settings_(settings) {}

  void look_about(const RigidTransform& T, const SearchBounds& bounds) {
    view_.look_about(T, bounds, [this] { return cancelled(); });
  }
  /// Asks whether to go on. Once not, all scores are zero and cost nothing, so that every step soon comes to its end.
  [[nodiscard]] bool cancelled() {
    return cancelled_ = cancelled_ || (settings_.keep_going && !settings_.keep_going());
  }

  /// The mean score less a penalty for leaving the bounds: they are a box in the LiDAR's own parameters, which is none
  /// in the search variables.
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

  /// How far the axis may go, in units; with any orientation, how far from a place that the grid gave.
  [[nodiscard]] double room(int axis) const {
    return axis < 3 && settings_.any_orientation ? 30 : limit(axis) / unit_of(axis);
  }

  /// The best of a grid of rotations, by few classes and few points. Its best places are followed uphill a little
  /// before one of them is chosen.
  [[nodiscard]] Result<RigidTransform> coarse();

  /// Maximises from `T_base` over rotations about the LiDAR (`parameters` 3), over all six about a point ahead of the
  /// camera (6), or over the released axes one by one (0). Returns the best extrinsic seen: where roundoff ends the
  /// search, NLopt's last point is not always that.
  [[nodiscard]] Result<RigidTransform> maximise(const RigidTransform& T_base, int parameters, double first_step,
                                                const Objective& objective, int budget = most_evaluations);
  /// Again from where it ended, as long as that helps: BOBYQA's model of a narrow valley ends it early.
  [[nodiscard]] Result<RigidTransform> maximise_again(RigidTransform T, int parameters, double first_step,
                                                      const Objective& objective);

  /// Directions (columns) of the hill at `T`, each as long as it takes to lose the same small part of the score: along
  /// a valley they are long, across it short. From second differences.
  [[nodiscard]] Matrix6 hill_directions(const RigidTransform& T, const Objective& objective);
  using Place = std::function<RigidTransform(const Eigen::VectorXd&)>;
  struct Climb {
    double radius = 1;       // of the first batch
    int batches = 3;         // and one more when the top is not within reach by then
    bool to_the_top = true;  // BOBYQA goes on when it still is not
  };
  /// Maximises over parameters of which one unit loses about as much of the score as another, from zero: by quadratics
  /// through batches of samples, each about the top of the one before. Near the hill this takes fewer evaluations than
  /// BOBYQA and ends nearer to its top, because it looks through the small hills on it. Returns the best extrinsic
  /// seen.
  [[nodiscard]] Result<RigidTransform> climb(int parameters, const Place& place, const Objective& objective,
                                             const Climb& how);
  /// All six, along `directions`.
  [[nodiscard]] Result<RigidTransform> climb_along(const RigidTransform& T_base, const Matrix6& directions,
                                                   const Objective& objective, const Climb& how);

  /// 3 when rotation alone is sought, 6 for everything, 0 for any other choice of axes.
  [[nodiscard]] int parameters() const;
  void tell(double share) const {
    if (settings_.progress) settings_.progress(share);
  }
  [[nodiscard]] int evaluations() const { return evaluations_; }
  [[nodiscard]] bool exhausted() const { return exhausted_; }

 private:
  /// By BOBYQA, again from where it ended as long as that helps.
  [[nodiscard]] Result<RigidTransform> follow_valley(const Place& place, Eigen::VectorXd start,
                                                     const Objective& objective);
  struct Run {
    double first_step = 1, tolerance = 2e-3;
    int budget = most_evaluations;
  };
  /// One run of BOBYQA from `x`, within `room` to either side of zero.
  [[nodiscard]] Result<void> optimise(std::vector<double> x, const std::vector<double>& room, const Run& run,
                                      const std::function<double(const std::vector<double>&)>& objective);

  View view_;
  RigidTransform T_start_;
  const SearchSettings& settings_;
  int evaluations_ = 0;
  bool exhausted_ = false;
  bool cancelled_ = false;
};

}  // namespace calib
