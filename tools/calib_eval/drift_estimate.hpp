#pragma once

#include <vector>

#include "calib/drift.hpp"
#include "calib_eval/drift_sequences.hpp"

namespace calib::eval {

/// What calibd would report of a LiDAR that has moved, along the axis of the movement (rad or m).
struct Estimate {
  double error = 0, sigma = 0;
};

/// A search uses so many frames, as calibd's do, or all where there are fewer.
inline constexpr std::size_t frames_per_estimate = 12;

/// Estimates `count` times the misalignment of a LiDAR that has moved along `axis` by `moved` (rad or m) from
/// `T_camera_lidar`, where `features` were made, as calibd does: by a search, with the bias that the baseline of
/// `monitor` shows. Frames are drawn as sequences are. Estimate `number` is empty where the search found nothing within
/// calibd's usual bounds. The same at any number of threads.
[[nodiscard]] std::vector<std::optional<Estimate>> estimates_of(const std::vector<FeatureSet>& features,
                                                                const RigidTransform& T_camera_lidar, int axis,
                                                                double moved, bool monocular_depth,
                                                                const DriftMonitor& monitor,
                                                                const SequenceSettings& settings, std::size_t count);

}  // namespace calib::eval
