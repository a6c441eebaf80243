#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "calib/mutual_information.hpp"

namespace calib {

/// Half width of the stencil: wide enough for a parabola through three noisy scores, narrow enough to be local.
struct StencilStep {
  double rotation_rad = 0.5 * radians_per_degree;
  double translation_m = 0.1;
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
                                       const StencilStep& step = {});

/// Where one frame has its optimum along each axis: the vertex of the parabola through the three scores, in the LiDAR
/// frame (rad, m), within one step. Beyond the step the parabola says nothing: `limited` axes are at least that far.
struct AxisOffsets {
  Vector6 delta = Vector6::Zero();
  std::array<bool, 6> limited{};
};
[[nodiscard]] AxisOffsets axis_offsets(const Stencil& stencil, const StencilStep& step = {});

struct DriftSettings {
  /// Pairs from which the extrinsic's own offsets and spread are learned after it was accepted.
  int baseline_pairs = 20;
  /// CUSUM reference value and decision limit, in standard deviations of one pair. With k = 1, h = 8 a one-sided test
  /// of independent normal values has an average run length of 4.6e7 pairs to a false alarm (Siegmund 1985); a shift of
  /// three standard deviations takes four pairs.
  double cusum_k = 1, cusum_h = 8;
  /// One pair counts for no more than this: a single bad frame must not decide.
  double max_deviation = 4;
  /// A depth source shifts the optimum by a constant; an offset within these limits is taken for that when the
  /// baseline is learned, anything beyond is misalignment.
  double max_bias_rotation_rad = 0.35 * radians_per_degree;
  double max_bias_translation_m = 0.2;
};

/// `learning`: the baseline is not known yet and nothing speaks of misalignment.
enum class DriftVerdict { learning, calibrated, suspect, drifted };

/// What the monitor knows; everything of it survives a restart.
struct DriftState {
  /// Offsets seen while the baseline was learned; empty when it is known.
  std::vector<Vector6> learning;
  std::optional<Vector6> baseline;   // median offset of the accepted extrinsic
  Vector6 spread = Vector6::Zero();  // standard deviation of one pair's offset; valid with `baseline`
  std::optional<double> baseline_score;  // mean objective while it was learned
  double score_sum = 0;
  Vector6 cusum_up = Vector6::Zero(), cusum_down = Vector6::Zero();
  /// Stamp of the first pair of each run of evidence that still counts: when the drift began, should it be one.
  std::array<Timestamp, 6> up_since{}, down_since{};
  struct Observation {
    Timestamp stamp{};
    Vector6 delta = Vector6::Zero();
  };
  std::vector<Observation> recent;  // the latest pairs, oldest first
  DriftVerdict verdict = DriftVerdict::learning;
};

/// Decides, pair after pair, whether the extrinsic still is where it was when it was accepted: a two-sided CUSUM per
/// axis on the offsets of single pairs, standardised by the vehicle's own spread (Page 1954). While the baseline is
/// being learned the test runs against zero, with the bias a depth source may have allowed for, so that an extrinsic
/// that was wrong from the start is found too.
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
  /// Needs three pairs.
  struct Estimate {
    Vector6 delta, sigma;
  };
  [[nodiscard]] std::optional<Estimate> misalignment() const;
  /// Stamp of the pair at which the evidence that led to `suspect` or `drifted` begins.
  [[nodiscard]] std::optional<Timestamp> first_sign() const;
  [[nodiscard]] const DriftState& state() const { return state_; }
  [[nodiscard]] const DriftSettings& settings() const { return settings_; }

 private:
  [[nodiscard]] Vector6 standardised(const AxisOffsets& offsets) const;
  void accumulate(const Vector6& deviation, Timestamp stamp);
  void learn(const Vector6& delta, double score);
  [[nodiscard]] DriftVerdict decide() const;

  DriftSettings settings_;
  DriftState state_;
};

}  // namespace calib
