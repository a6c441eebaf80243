#pragma once

#include <functional>
#include <optional>
#include <vector>

#include "calib/drift.hpp"
#include "calib_eval/drift_evidence.hpp"

namespace calib::eval {

/// Numbers of frames as they follow each other in a sequence: blocks of neighbours from a place that is drawn (the
/// last frame's neighbour is the first), so that what frames have in common stays in (circular block bootstrap;
/// Politis and Romano 1992).
class FrameDraw {
 public:
  FrameDraw(std::size_t frames, std::size_t block, std::uint64_t key) : frames_(frames), block_(block), key_(key) {}
  std::size_t next();

 private:
  std::size_t frames_, block_;
  std::uint64_t key_, drawn_ = 0;
  std::size_t at_ = 0, left_ = 0;
};

/// The length that lets the number of blocks grow quickest without cutting what belongs together: n^(1/3).
[[nodiscard]] std::size_t usual_block(std::size_t frames);

/// How sequences are drawn, and how they are judged.
struct SequenceSettings {
  DriftSettings drift;
  std::size_t block = 1;
  /// Whether two frames show the same scene, [frame][frame]; empty: none do.
  std::vector<std::vector<bool>> same_scene;
  double period_s = 10;
  double driving_hours_per_week = 56;
  std::uint64_t seed = 1;
  int threads = 1;

  [[nodiscard]] double pairs_per_week() const { return driving_hours_per_week * 3600 / period_s; }
};

/// The verdicts of vehicles whose LiDAR does not move.
struct NullRun {
  std::int64_t sequences = 0;
  /// Pairs on which there was a verdict; those of a baseline that is being learned, and those without a verdict because
  /// of insufficient detection power.
  std::int64_t decisions = 0, learning = 0, insufficient_power = 0;
  /// Verdicts "drifted", and those of them before a baseline was learned; times that "calibrated" became "suspect".
  std::int64_t false_alarms = 0, from_start = 0, false_suspects = 0;
  double weeks = 0;  // of driving, with decisions and without: an alarm may end a time without detection power, too

  /// Nothing where there was no decision at all.
  [[nodiscard]] std::optional<double> per_1000_weeks() const;
  /// The rate that would have given more false alarms with a probability of 95 %.
  [[nodiscard]] std::optional<double> upper95_per_1000_weeks() const;
};

/// Every vehicle learns a baseline of its own and drives for up to `weeks_per_vehicle`; after a false alarm it begins
/// anew. `done` is called after each of `vehicles_for(weeks)` vehicles, from any thread.
[[nodiscard]] NullRun drive_without_drift(const std::vector<AxisEvidence>& still, const SequenceSettings& settings,
                                          double weeks, const std::function<void()>& done);
[[nodiscard]] std::size_t vehicles_for(double weeks);
inline constexpr double weeks_per_vehicle = 10;

/// The largest mean of a Poisson variable whose probability of being `count` or less is still 5 % (Garwood 1936).
[[nodiscard]] double poisson_upper95(std::int64_t count);

/// The monitor of vehicle `number` once its baseline is complete, with a LiDAR that does not move; nothing when no
/// baseline is ever learned.
[[nodiscard]] std::optional<DriftMonitor> experienced_monitor(const std::vector<AxisEvidence>& still,
                                                              const SequenceSettings& settings, std::size_t number);

/// How a LiDAR leaves its place: by `at_once`, and by `per_pair` with every pair from then on (rad or m, along the axis
/// of `ladder`).
struct Movement {
  const Ladder* ladder = nullptr;
  double at_once = 0, per_pair = 0;
  [[nodiscard]] double offset(int pair) const { return at_once + per_pair * pair; }
};

/// A vehicle whose LiDAR moves after some pairs.
struct MovedRun {
  bool learned = false;      // there was a baseline at all; else nothing of the rest is known
  int pairs_before = 0;      // the LiDAR moved
  bool detectable = false;   // the whole movement is at or above the detection limit
  std::optional<int> delay;  // pairs from the movement on until "drifted"; nothing: never
};
/// A LiDAR moves between the last pair of the baseline's first learning and so many pairs later.
inline constexpr int most_pairs_before = 100;

/// Called after each pair that a vehicle has taken.
using Watch = std::function<void(const DriftMonitor& monitor, bool moved)>;

/// Sequence `number`; given up `pairs` after the movement. Frames are drawn alike for all movements.
[[nodiscard]] MovedRun drive_with(const Movement& movement, const std::vector<AxisEvidence>& still,
                                  const SequenceSettings& settings, int pairs, std::size_t number,
                                  const Watch& watch = {});

}  // namespace calib::eval
