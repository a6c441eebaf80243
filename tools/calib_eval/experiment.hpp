#pragma once

#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "calib_eval/recording_frames.hpp"
#include "calib_eval/starts.hpp"

namespace calib::eval {

/// What one row of a table is about.
struct Cell {
  Method method = Method::standard;
  int degrees_of_freedom = 3;  // 3: roll, pitch, yaw; 6: all
  ErrorRange range;
  bool monocular_depth = false;

  [[nodiscard]] std::array<bool, 6> free_axes() const {
    const bool six = degrees_of_freedom == 6;
    return {true, true, true, six, six, six};
  }
};

/// One search. Motions are those of the LiDAR in its own frame against the true extrinsic.
struct Run {
  RigidTransform start = RigidTransform::Identity();
  /// Where it ended, or why it did not.
  Result<SearchResult> result = fail(ErrorCode::not_run, "");
  RigidTransform end = RigidTransform::Identity();  // of no meaning without a result
  double seconds = 0;                               // of one core

  [[nodiscard]] double rotation_error_rad() const { return rotation_angle_rad(end); }
  [[nodiscard]] double translation_error_m() const { return end.translation().norm(); }
  /// Paper, Sec. "Experiments": less than 0.5 degrees and 20 cm off.
  [[nodiscard]] bool hit() const {
    return result && rotation_error_rad() < hit_rotation_rad && translation_error_m() < hit_translation_m;
  }
  static constexpr double hit_rotation_rad = 0.5 * radians_per_degree, hit_translation_m = 0.2;
};

/// Mean and sample standard deviation of (roll, pitch, yaw [deg], x, y, z [cm]); nothing where there are too few
/// values.
struct Spread {
  std::optional<Vector6> mean, standard_deviation;
};

/// A cell's figures. Those over no run at all are nothing.
struct Summary {
  int starts = 0, hits = 0, failures = 0;
  std::optional<double> hit_rotation_error_deg, hit_translation_error_cm;  // means over the hits
  Spread of_hits, of_all;
  std::optional<double> evaluations, seconds_per_run;
};
[[nodiscard]] Summary summarise(const std::vector<Run>& runs);

/// (roll, pitch, yaw [deg], x, y, z [cm]) of a motion.
[[nodiscard]] Vector6 in_degrees_and_cm(const Vector6& delta);

/// The optimum that scores best of all runs (of those that think of the depth's bias as most do): what the frames say
/// the extrinsic is, and with what standard error.
struct Best {
  std::size_t run = 0;
  Uncertainty uncertainty;
};

struct Experiment {
  Cell cell;
  std::vector<Run> runs;
  std::optional<Best> best;  // nothing when no run has a result
};

struct Protocol {
  int starts = 200;
  std::uint64_t seed = 1;
  int threads = 1;
  /// Called after each run, from any thread.
  std::function<void()> run_done = [] {};
};

/// All runs of a cell, in the order of their starts, whatever the number of threads. Features are made for the cell
/// alone, so that its figures do not depend on the others. Fails as `RecordingFrames::features` does.
[[nodiscard]] Result<Experiment> conduct(const RecordingFrames& recording_frames, const Cell& cell,
                                         const Protocol& protocol);

}  // namespace calib::eval
