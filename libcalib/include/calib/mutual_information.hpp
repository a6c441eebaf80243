#pragma once

#include <array>
#include <span>

#include "calib/features.hpp"

namespace calib {

/// Which histogram the score is taken from.
struct ObjectiveOptions {
  /// Classes per feature, 2 .. 64. Fewer give a wider basin, more a sharper optimum.
  int bins = 64;
  /// Visits every n-th point only; for coarse searches.
  int stride = 1;
};

/// Normalised mutual information (H(X) + H(Y)) / H(X, Y), after Studholme 1999, of a frame's LiDAR range and image depth:
/// 1 for independent features, more the more one tells of the other, at most 2. It is the paper's D2D mutual information (Eq. "MI") over ranks
/// instead of linear bins, divided so that a change of overlap moves it least; the joint histogram is smoothed with
/// [1 2 1]/4 in both directions.
struct Score {
  double value = 0;
  /// Points that landed on a pixel with depth.
  std::size_t points = 0;
};

/// The score of one frame at an extrinsic. With fewer than `min_scored_points` points it is 1: no information.
[[nodiscard]] Score score(const FeatureSet& features, const RigidTransform& T_camera_lidar,
                          const ObjectiveOptions& options = {});
inline constexpr std::size_t min_scored_points = 200;

/// Frames as they are kept, each somewhere of its own; none is null.
using Frames = std::span<const FeatureSet* const>;

/// The mean score over frames (paper, Eq. "MI average"; pooling the histograms instead is measurably worse).
/// Points are summed.
[[nodiscard]] Score mean_score(Frames frames, const RigidTransform& T_camera_lidar,
                               const ObjectiveOptions& options = {});

}  // namespace calib
