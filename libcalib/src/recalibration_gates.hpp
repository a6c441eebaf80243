#pragma once

#include <optional>
#include <string>
#include <vector>

#include "calib/recalibrate.hpp"

namespace calib {

/// An extrinsic that a search has found, and what it takes to judge it.
struct Candidate {
  Frames fit, held_back;
  RigidTransform T_before, T_after;
  /// Motion of the LiDAR from before to after, and its covariance.
  Vector6 delta = Vector6::Zero();
  Matrix6 covariance = Matrix6::Zero();
  /// Axes that the search was free to move, and those that it left because they are not observable.
  std::array<bool, 6> free_axes{}, left{};
  bool monocular_depth = false;
  /// Why its search ended, in words, when that was at a bound; else empty.
  std::string at_limit;

  [[nodiscard]] std::vector<const FeatureSet*> all_frames() const;
};

/// How much better `after` is than `before`, frame by frame: mean difference of the scores and its standard error.
struct Gain {
  double mean = 0, standard_error = 0;
  [[nodiscard]] bool exceeds(double sigmas) const { return mean > sigmas * standard_error && mean > 0; }
};
[[nodiscard]] Gain gain(Frames frames, const RigidTransform& before, const RigidTransform& after,
                        const Objective& objective);

/// "score on pairs held back changes by +0.0123 +- 0.0040".
[[nodiscard]] std::string held_back_in_words(const Gain& held_back);

/// Why a candidate must not be used, in words; nothing when the gate lets it pass.
using Objection = std::optional<std::string>;

/// In the order of recalibrate.hpp, in which objections are named.
[[nodiscard]] Objection insufficient_observability(const Candidate& candidate);
[[nodiscard]] Objection outside_bounds(const Candidate& candidate);
[[nodiscard]] Objection no_more_than_bias(const Candidate& candidate, const RecalibrationSettings& settings);
[[nodiscard]] Objection not_better(const Gain& held_back, const RecalibrationSettings& settings);
[[nodiscard]] Objection contradicts_expectation(const Candidate& candidate, const Expectation& expected);
[[nodiscard]] Objection contradicts_intensity(const Candidate& candidate);
[[nodiscard]] Objection score_not_restored(const Candidate& candidate, const BaselineScore& baseline);
/// The only expensive gate. Fails as `search` does; adds to `evaluations`.
[[nodiscard]] Result<Objection> not_repeatable(const Candidate& candidate, const std::function<bool()>& keep_going,
                                               int& evaluations);

}  // namespace calib
