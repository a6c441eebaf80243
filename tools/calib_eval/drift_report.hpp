#pragma once

#include <string>
#include <vector>

#include "calib_eval/drift_estimate.hpp"
#include "calib_eval/report.hpp"

namespace calib::eval {

/// Detection power of a monitor along an axis once its baseline is complete, median over vehicles: standard deviation
/// of one pair's offset, and the detection limit. Degrees or cm; nothing where the axis is not observable.
struct AxisPower {
  std::optional<double> sigma_of_pair, detection_limit;
};
using DetectionPower = std::array<AxisPower, 6>;
/// Nothing when no vehicle ever learns a baseline.
[[nodiscard]] std::optional<DetectionPower> detection_power(const std::vector<AxisEvidence>& still,
                                                            const SequenceSettings& settings);

/// All sequences of one movement.
struct MovedRuns {
  int axis = 0;
  double magnitude = 0;  // signed, in `unit`
  std::string unit;      // deg, cm, or deg/h for a LiDAR that creeps
  std::vector<MovedRun> runs;
  std::vector<std::optional<Estimate>> estimates;  // empty for a LiDAR that creeps

  struct Summary {
    int sequences = 0;  // those with a baseline
    int detected = 0;
    int foretold = 0;  // not detected, and below the detection limit
    /// Over all sequences, those without a detection last: nothing when it falls among them.
    std::optional<int> median_delay, p95_delay;
    /// Medians over the estimates (deg or cm): the size of the error, and the standard deviation that is told.
    std::optional<double> estimate_error, estimate_sigma;
    int estimates = 0, within_2_sigma = 0;
  };
  [[nodiscard]] Summary summarise() const;
};

/// One sequence, pair after pair.
struct Timeline {
  const MovedRuns* of = nullptr;
  std::size_t moved_at = 0;  // number of the first pair after the LiDAR has moved
  std::vector<DriftVerdict> verdicts;
  /// Of each axis, and of the loss of the maximum: the largest share of its limit that a chart has reached.
  std::vector<std::array<double, 7>> evidence;

  void add(const DriftMonitor& monitor, bool moved);
};

/// Null and movements, judged by a monitor that may give so many false alarms.
struct OperatingPoint {
  double false_alerts_per_1000_vehicle_weeks = 0;
  NullRun null;
  std::vector<MovedRuns> moved;
};

[[nodiscard]] Json to_json(const NullRun& run);
[[nodiscard]] Json to_json(const MovedRuns& runs, bool with_delays);
[[nodiscard]] Json to_json(const Timeline& timeline);
[[nodiscard]] Json to_json(const std::optional<DetectionPower>& detection_power);
[[nodiscard]] Json to_json(const OperatingPoint& point);

/// Lines of standard output.
[[nodiscard]] std::string to_text(const std::optional<DetectionPower>& detection_power);
[[nodiscard]] std::string to_text(const NullRun& run);
[[nodiscard]] std::string drift_heading();
[[nodiscard]] std::string drift_line(const MovedRuns& runs);

}  // namespace calib::eval
