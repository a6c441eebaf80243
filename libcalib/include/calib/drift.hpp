#pragma once

#include <array>
#include <deque>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "calib/cusum.hpp"
#include "calib/misalignment.hpp"

namespace calib {

/// Half width of a stencil. The usual one is narrow enough to resolve a quarter of a degree, and wide enough that a
/// maximum some degrees away still gives a slope.
struct StencilStep {
  double rotation_rad = 0.75 * radians_per_degree;
  double translation_m = 0.15;
  [[nodiscard]] double of_axis(int axis) const { return axis < 3 ? rotation_rad : translation_m; }
};

/// The widths of the stencil for a depth source. With stereo, one. With monocular depth the objective has a sharp
/// maximum, which intensity makes, on a broad one: a narrow width resolves a quarter of a degree twice as well as the
/// usual one, and a wide width still finds the side on which the maximum lies when it is a degree away.
[[nodiscard]] std::span<const StencilStep> stencil_steps(bool monocular_depth);

/// The objective at an extrinsic and at one step to either side along each axis (12 points a width), for one frame: is
/// the current extrinsic the best of its neighbours (Levinson and Thrun 2013)?
struct Stencil {
  struct Width {
    StencilStep step;
    Vector6 minus = Vector6::Zero(), plus = Vector6::Zero();
  };
  double current = 0;
  std::vector<Width> widths;

  [[nodiscard]] double best_neighbour() const;
};
[[nodiscard]] Stencil evaluate_stencil(const FeatureSet& frame, const RigidTransform& T_camera_lidar,
                                       std::span<const StencilStep> steps = stencil_steps(false),
                                       const Objective& objective = depth_objective);

/// The evidence of one frame's stencil about each axis, LiDAR frame.
struct AxisEvidence {
  Timestamp stamp{};
  /// First central difference of the score, per rad and m, mean over the widths. Positive: the optimum lies at a
  /// positive perturbation, to which the LiDAR has moved.
  Vector6 slope = Vector6::Zero();
  double score = 0;
  /// By how much the score exceeds the mean of its neighbours. Where there is no maximum nearby the slopes
  /// vanish and so does the prominence, which shows the loss.
  double prominence = 0;
  /// Change of the slopes (rows) when the LiDAR moves along each axis (columns), per rad and m. It takes a dozen
  /// stencils, so it is measured only for the first pairs from which a baseline is learned.
  std::optional<Matrix6> sensitivity{};
  /// Taken in the scene of the latest evidence (`scene_change`): depth errs there as it did, so that this is no further
  /// evidence.
  bool same_scene = false;
};
[[nodiscard]] AxisEvidence axis_evidence(const Stencil& stencil, Timestamp stamp);
[[nodiscard]] Matrix6 evaluate_sensitivity(const FeatureSet& frame, const RigidTransform& T_camera_lidar,
                                           std::span<const StencilStep> steps = stencil_steps(false),
                                           const Objective& objective = depth_objective);

/// The evidence that the accepted extrinsic gives in this vehicle's own scenes and with its own depth source: running
/// moments (Welford 1962) over pairs taken while there was no evidence of drift.
struct DriftBaseline {
  int pairs = 0, sensitivities = 0;                    // of the latter, those with a sensitivity
  Vector6 slope = Vector6::Zero();                     // mean
  Matrix6 slope_products = Matrix6::Zero();            // sum of products of deviations
  Vector6 latest_slope = Vector6::Zero();              // of the pair added last
  Vector6 lag1_products = Vector6::Zero();             // lag 1: sum of products of deviations of consecutive pairs
  Matrix6 sensitivity = Matrix6::Zero();               // mean
  Vector6 sensitivity_squares = Vector6::Zero();       // of its diagonal: sum of squared deviations
  double prominence = 0, prominence_squares = 0;       // mean, sum of squared deviations
  double latest_prominence = 0, lag1_prominences = 0;  // as of slopes
  double score = 0, score_squares = 0;                 // mean, sum of squared deviations
  /// How the mean slopes of batches wandered about the mean before them: sum of squared deviations, each 1 for
  /// independent pairs.
  int batches = 0;
  Vector6 batch_squares = Vector6::Zero();

  void add(const AxisEvidence& evidence);
  /// Adds the pairs of another baseline, which came after those of this one (Chan, Golub and LeVeque 1979).
  void merge(const DriftBaseline& batch);
  /// How far the mean slopes of a batch that came later are from those of this one, in standard errors that they would
  /// have if pairs were independent.
  [[nodiscard]] Vector6 distances(const DriftBaseline& batch) const;
  /// Standard deviation of one pair's slope as it contributes to long sums: larger where consecutive pairs are
  /// correlated, and estimated high as long as it is of few pairs.
  [[nodiscard]] double spread(int axis) const;
  /// By how much larger the deviation of a sum over many scenes is than that of independent pairs; at least 1. Roads
  /// differ, and depth errs on each in its own way.
  [[nodiscard]] double wander(int axis) const;
  /// Likewise as `spread`, of the prominence.
  [[nodiscard]] double prominence_spread() const;
  /// Whether the scenes carry information about the axis: its mean sensitivity is significantly that of a maximum.
  [[nodiscard]] bool observable(int axis) const;
};

struct DriftSettings {
  /// Pairs, each of a scene of its own, from which the baseline is learned after an extrinsic was accepted, before
  /// there is a verdict. While there is no evidence of drift, learning continues to `max_baseline_pairs`: the smaller
  /// the shift, the better the mean must be known.
  int baseline_pairs = 20, max_baseline_pairs = 2000;
  /// Within so many pairs a shift must be detected; two hours of driving at a pair every ten seconds. The charts and
  /// the detection limits follow from it: small shifts take many pairs.
  double pairs_to_detect = 720;
  /// Largest rate of false alarms, per pair: one in a thousand vehicle-weeks of 56 hours at a pair every ten seconds.
  /// The limits of the charts follow from it (`cusum_limit`).
  double false_alarms_per_pair = 1 / (1000 * 56 * 360.0);
  /// Pairs whose images differ by less (`scene_change`) show the same scene; 0: each pair is a scene of its own. On
  /// recorded streets, images of different places differ by more than 0.55 nine times out of ten, and those of 7.5
  /// seconds of slow traffic by up to 0.52.
  double min_scene_change = 0.3;
  /// Smaller shifts are not tested for: scenery and depth move the optimum by as much.
  double negligible_rotation_rad = 0.05 * radians_per_degree;
  double negligible_translation_m = 0.02;
  /// Where the detection limit of a rotation exceeds this, there is no verdict. The detection limits of translations
  /// are only reported.
  double must_detect_rotation_rad = 0.5 * radians_per_degree;
  /// A depth source shifts the optimum by a constant. While the baseline is learned, an offset within these limits is
  /// attributed to the depth source; a significantly larger one is misalignment from the start. Infinite: none is.
  double max_bias_rotation_rad = 0.35 * radians_per_degree;
  double max_bias_translation_m = 0.2;
};

/// The defaults for a depth source. The bias of monocular depth may be larger before it is learned as the baseline, and
/// moves the optimum's translation by decimetres.
[[nodiscard]] DriftSettings usual_drift_settings(bool monocular_depth);

/// `learning`: there is no baseline yet and no evidence of misalignment. `insufficient_power`: there is one, and the
/// detection limit of a rotation exceeds what must be detected.
enum class DriftVerdict { learning, insufficient_power, calibrated, suspect, drifted };
[[nodiscard]] constexpr bool speaks_of_drift(DriftVerdict verdict) {
  return verdict == DriftVerdict::suspect || verdict == DriftVerdict::drifted;
}

/// Charts on one sequence, by falling reference value: the first finds large shifts within a few pairs, each further
/// one finds smaller shifts within more.
inline constexpr std::size_t most_charts = 5;
using Charts = std::array<Cusum, most_charts>;

/// The charts of an axis: of shifts in its positive and in its negative direction.
struct AxisCharts {
  Charts positive{}, negative{};
  bool operator==(const AxisCharts&) const = default;
};

/// What the monitor knows; everything of it survives a restart.
struct DriftState {
  /// The latest pairs that count, oldest first; the last `unlearned` of them are not part of the baseline, or not yet.
  std::deque<AxisEvidence> recent;
  int unlearned = 0;
  /// Pairs in turn that were no further evidence.
  int repeats = 0;
  DriftBaseline baseline;
  /// Batches on their way into the baseline: the one that is being gathered, and the one that waits so long. By then a
  /// shift has shown itself, so that it does not become part of what it is compared with.
  DriftBaseline gathered, waiting;
  /// Batches that together deviate from the baseline, for as long as it is open whether that is drift.
  DriftBaseline doubtful;
  std::array<AxisCharts, 6> charts{};
  /// Those of the loss of the maximum.
  Charts loss_charts;
  DriftVerdict verdict = DriftVerdict::learning;
};

/// Decides, pair after pair, whether the LiDAR has moved since the extrinsic was accepted: two-sided CUSUMs per axis
/// (Page 1954) on the slope of the objective at the extrinsic, standardised by the vehicle's own spread. A pair of the
/// same scene as the one before is no further evidence, but for one in thirty once there is a baseline. Each update is
/// the median of the latest three pairs, so that a single outlier has no effect. The slope reacts first when the
/// optimum moves, has light tails where the vertex of a fitted parabola has heavy ones, and needs no curvature. While
/// the baseline is learned, the pooled offset is tested against the bias that a depth source may have, so that an
/// extrinsic that was wrong from the start is found too.
class DriftMonitor {
 public:
  /// Pairs of the baseline with a sensitivity: more of them would tell little.
  static constexpr int enough_sensitivities = 100;

  explicit DriftMonitor(const DriftSettings& settings, DriftState state = {});

  /// Whether the next pair's evidence should have a sensitivity: the baseline has few of them.
  [[nodiscard]] bool wants_sensitivity() const;
  /// Whether the baseline is still being learned.
  [[nodiscard]] bool learning() const { return state_.baseline.pairs < settings_.max_baseline_pairs; }
  /// Takes the evidence of one pair. Fails with `sensitivity_missing`, and takes nothing, while there is no baseline
  /// and `evidence` has no sensitivity.
  Result<DriftVerdict> observe(const AxisEvidence& evidence);

  /// A new extrinsic is in force: forgets everything.
  void restart();

  [[nodiscard]] DriftVerdict verdict() const { return state_.verdict; }
  /// The verdict in words; of drift, with the axes that have moved, by `found` where something better than
  /// `misalignment` is known.
  [[nodiscard]] std::string reason(const std::optional<Misalignment>& found = {}) const;
  /// Whether there is a baseline.
  [[nodiscard]] bool learned() const { return state_.baseline.pairs >= settings_.baseline_pairs; }

  /// Misalignment estimated from the latest pairs against the baseline, LiDAR frame (rad, m); from those since the
  /// onset, where there is one. One shift changes the slopes of several axes (pitch and z, yaw and y), so `delta` is
  /// the sparsest explanation: as few axes as are significant, at most two stencil steps each; a value at that bound
  /// means "at least". `covariance` is that of all explanations under a normal prior of one stencil step per axis.
  /// Outside the basin each axis is estimated separately, with a standard deviation of two stencil steps. Needs three
  /// pairs and a baseline.
  [[nodiscard]] std::optional<Misalignment> misalignment() const;
  /// What a search has found, with the bias of the depth source in its variance: as the slopes of the baseline show it,
  /// or as much as is allowed for where there is no baseline, and no more than the search's bounds.
  [[nodiscard]] Misalignment with_bias(Misalignment found, const SearchBounds& bounds) const;
  /// The smallest shift along an axis (rad or m) that is detected within `pairs_to_detect`; infinite for an axis that
  /// is not observable, and without a baseline.
  [[nodiscard]] double detection_limit(int axis) const;
  /// Pairs, each of a scene of its own, after which a rotation of `must_detect_rotation_rad` is detected, about
  /// whichever axis it is: the expected delay. Infinite where an axis is not observable or its detection limit is
  /// larger, and without a baseline.
  [[nodiscard]] double pairs_to_notice() const;
  /// Stamp of the pair where the evidence of drift begins; `Timestamp::min()` for an extrinsic wrong from the start.
  [[nodiscard]] std::optional<Timestamp> onset() const;
  /// The largest sum of an axis' charts, and of those of the loss of the maximum, as a share of its limit.
  [[nodiscard]] double evidence(int axis) const;
  [[nodiscard]] double loss_evidence() const;
  /// Whether there is evidence of the loss of the maximum: the LiDAR has moved out of the basin.
  [[nodiscard]] bool maximum_is_lost() const;
  [[nodiscard]] const DriftState& state() const { return state_; }
  [[nodiscard]] const DriftSettings& settings() const { return settings_; }

 private:
  [[nodiscard]] double evidence() const;
  [[nodiscard]] double share(const Charts& charts) const;
  /// Of an axis, in standard deviations of one pair: the shift that is not tested for.
  [[nodiscard]] double negligible(int axis) const;
  /// In standard deviations: by how much the mean of the baseline may err.
  [[nodiscard]] double mean_error() const;
  /// In standard deviations: the reference value of a chart.
  [[nodiscard]] double reference(std::size_t chart) const;
  [[nodiscard]] double loss_reference(std::size_t chart) const;
  /// By how much the deviations of an axis must be divided for a chart.
  [[nodiscard]] double wander(int axis, std::size_t chart) const;
  /// Whether the loss of the maximum would be detected within so many pairs.
  [[nodiscard]] bool detects_lost_maximum(double pairs) const;
  void accumulate();
  void retire_oldest();
  [[nodiscard]] bool is_outlier_free(const AxisEvidence& evidence) const;
  [[nodiscard]] DriftVerdict decide() const;
  [[nodiscard]] DriftVerdict decide_from_start() const;
  [[nodiscard]] std::string least_detectable() const;
  [[nodiscard]] std::string first_look() const;
  [[nodiscard]] std::string moved_axes(const std::optional<Misalignment>& found) const;

  DriftSettings settings_;
  std::vector<double> limits_;  // of the charts that are in use
  DriftState state_;
};

}  // namespace calib
