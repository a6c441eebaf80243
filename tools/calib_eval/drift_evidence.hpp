#pragma once

#include <functional>
#include <string>
#include <vector>

#include "calib/drift.hpp"
#include "calib_eval/recording_frames.hpp"

namespace calib::eval {

/// Evidence of the frames for a LiDAR that moves along one axis: at rung 0 it has not moved, and from each rung to the
/// next it moves by the same `step` (rad or m, signed).
struct Ladder {
  int axis = 0;
  double step = 0;
  std::vector<std::vector<AxisEvidence>> rungs;  // [rung][frame]; all with a sensitivity

  /// Evidence of a frame with the LiDAR `offset` away, between two rungs interpolated linearly. An offset beyond the
  /// last rung is one at the last.
  [[nodiscard]] AxisEvidence at(double offset, std::size_t frame) const;
};

/// Which ladder is wanted: `rungs` of them beyond the first.
struct LadderPlan {
  int axis = 0;
  double step = 0;
  int rungs = 1;
};

struct DriftEvidence {
  std::vector<AxisEvidence> still;  // of each frame, with a LiDAR that has not moved, with a sensitivity
  std::vector<Ladder> ladders;      // as planned
};

/// Leaves out the frames that a monitor would refuse. Fails with `too_few_frames` when fewer than
/// `fewest_drift_frames` remain.
[[nodiscard]] Result<void> admit(RecordingFrames& recording_frames);
/// Fewer frames cannot be resampled to any use.
inline constexpr std::size_t fewest_drift_frames = 8;

/// Evaluates each frame of the recording as a monitor does for which the recording's extrinsic is in force: a LiDAR
/// that has moved by d is one whose extrinsic in force lies d behind it. `monocular_depth` as of `drift_objective`.
/// `done` is called from any thread after each of `places_of(plans)` places and each frame. The same at any number of
/// threads. Fails as `make_features` does.
[[nodiscard]] Result<DriftEvidence> measure(const RecordingFrames& recording_frames,
                                            const std::vector<LadderPlan>& plans, bool monocular_depth, int threads,
                                            const std::function<void()>& done);
[[nodiscard]] std::size_t places_of(const std::vector<LadderPlan>& plans);

}  // namespace calib::eval
