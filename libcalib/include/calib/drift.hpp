#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "calib/mutual_information.hpp"

namespace calib {

/// Half width of the stencil: narrow enough to feel a quarter of a degree, wide enough that a hill some degrees away
/// still gives a slope.
struct StencilStep {
  double rotation_rad = 0.75 * radians_per_degree;
  double translation_m = 0.15;
  [[nodiscard]] double of_axis(int axis) const { return axis < 3 ? rotation_rad : translation_m; }
};

/// The objective at an extrinsic and at one step to either side along each axis (13 points), for one frame: is the
/// current extrinsic the best of its neighbours (Levinson and Thrun 2013)?
struct Stencil {
  double current = 0;
  Vector6 minus = Vector6::Zero(), plus = Vector6::Zero();

  [[nodiscard]] double best_neighbour() const;
};
[[nodiscard]] Stencil evaluate_stencil(const FeatureSet& frame, const RigidTransform& T_camera_lidar,
                                       const StencilStep& step = {}, const Objective& objective = depth_objective);

/// What one frame's stencil says of each axis, LiDAR frame: first and second central differences of the score, per rad
/// and m (and squared). A positive slope says that the optimum lies at a positive perturbation: there the LiDAR went.
struct AxisEvidence {
  Timestamp stamp{};
  Vector6 slope = Vector6::Zero(), curvature = Vector6::Zero();
  double score = 0;
};
[[nodiscard]] AxisEvidence axis_evidence(const Stencil& stencil, Timestamp stamp, const StencilStep& step = {});

struct DriftSettings {
  /// Pairs from which the extrinsic's own slopes and their spread are learned after it was accepted, before there is a
  /// verdict; as long as nothing speaks of drift, learning goes on to `max_baseline_pairs`.
  int baseline_pairs = 20, max_baseline_pairs = 100;
  /// CUSUM reference value and decision limit, in standard deviations of one pair. With k = 1.25, h = 10 independent
  /// normal values raise no false alarm in a vehicle's life (average run length 4e11, Siegmund 1985); real ones are
  /// heavier-tailed and the baseline comes of few pairs, which decides the true rate. A shift of four standard
  /// deviations takes four pairs. What is not sure of the baseline's mean, 1 / sqrt(pairs) deviations, is added to
  /// k 1.5 times.
  double cusum_k = 1.25, cusum_h = 10;
  /// One pair counts for no more than this: a single bad frame must not decide.
  double max_deviation = 4;
  /// A depth source shifts the optimum by a constant. While the baseline is learned, an offset within these limits is
  /// taken for that; one that is significantly beyond is misalignment from the start. Infinite: none is.
  double max_bias_rotation_rad = 0.35 * radians_per_degree;
  double max_bias_translation_m = 0.2;
};

/// `learning`: the baseline is not known yet and nothing speaks of misalignment.
enum class DriftVerdict { learning, calibrated, suspect, drifted };

/// How the accepted extrinsic looks in this vehicle's own scenes and with its own depth source: running moments
/// (Welford 1962) of the evidence of pairs taken while nothing spoke of drift.
struct DriftBaseline {
  int pairs = 0;
  Vector6 slope = Vector6::Zero(), slope_squares = Vector6::Zero();          // mean, sum of squared deviations
  Vector6 curvature = Vector6::Zero(), curvature_squares = Vector6::Zero();  // likewise
  double score = 0;                                                          // mean

  void add(const AxisEvidence& evidence);
  /// Standard deviation of one pair's slope, taken somewhat large as long as it comes of few pairs.
  [[nodiscard]] double spread(int axis) const;
  /// Whether the scenes tell anything of the axis at all: its mean curvature is significantly that of a hill.
  [[nodiscard]] bool observable(int axis) const;
};

/// What the monitor knows; everything of it survives a restart.
struct DriftState {
  std::vector<AxisEvidence> recent;  // the latest pairs, oldest first
  DriftBaseline baseline;
  Vector6 cusum_up = Vector6::Zero(), cusum_down = Vector6::Zero();
  /// Stamp of the first pair of each run of evidence that still counts: when the drift began, should it be one.
  std::array<Timestamp, 6> up_since{}, down_since{};
  DriftVerdict verdict = DriftVerdict::learning;
};

/// Decides, pair after pair, whether the extrinsic still is where it was when it was accepted: a two-sided CUSUM per
/// axis (Page 1954) on the slope of the objective at the extrinsic, standardised by the vehicle's own spread. The slope
/// is what moves first when an optimum moves, has light tails where the vertex of a parabola has heavy ones, and needs
/// no curvature. While the baseline is being learned the pooled offset is tested against the bias that a depth source
/// may have, so that an extrinsic that was wrong from the start is found too.
class DriftMonitor {
 public:
  explicit DriftMonitor(const DriftSettings& settings, DriftState state = {});

  /// Takes the evidence of one pair.
  DriftVerdict observe(const Stencil& stencil, Timestamp stamp, const StencilStep& step = {});

  /// A new extrinsic is in force: everything is learned anew.
  void restart();

  [[nodiscard]] DriftVerdict verdict() const { return state_.verdict; }
  /// The verdict in words, with the axes that caused it.
  [[nodiscard]] std::string reason() const;

  /// Misalignment estimated from the latest pairs (while there is a first sign of drift, from those since), against the
  /// baseline: each axis on its own, LiDAR frame (rad, m), so yaw and y, and pitch and z, each show much of the other.
  /// At most two stencil steps, beyond which it is "at least". An axis that is not observable is given as zero with a
  /// sigma of these two steps. Needs three pairs and a baseline.
  struct Estimate {
    Vector6 delta, sigma;
  };
  [[nodiscard]] std::optional<Estimate> misalignment() const;
  /// Stamp of the pair where the evidence of drift begins; `Timestamp::min()` for an extrinsic wrong from the start.
  [[nodiscard]] std::optional<Timestamp> first_sign() const;
  [[nodiscard]] const DriftState& state() const { return state_; }
  [[nodiscard]] const DriftSettings& settings() const { return settings_; }

 private:
  [[nodiscard]] bool learned() const { return state_.baseline.pairs >= settings_.baseline_pairs; }
  [[nodiscard]] double evidence() const;
  void accumulate(const AxisEvidence& evidence);
  [[nodiscard]] bool is_usual(const AxisEvidence& evidence) const;
  [[nodiscard]] DriftVerdict decide() const;
  [[nodiscard]] DriftVerdict decide_from_start() const;

  DriftSettings settings_;
  DriftState state_;
};

}  // namespace calib
