#pragma once

#include <cstdint>
#include <vector>

#include "calib/search.hpp"

namespace calib::eval {

/// How far off the starts of an experiment are.
struct ErrorRange {
  /// 0 .. 90, or `any_orientation_deg`: orientations drawn uniformly from all there are.
  double rotation_deg = 0;
  double translation_cm = 0;

  static constexpr double any_orientation_deg = 180;
  [[nodiscard]] bool any_orientation() const { return rotation_deg == any_orientation_deg; }
};

/// Point `index` of `count` on the unit sphere by the Fibonacci spiral, evenly spread (Gonzalez 2010).
[[nodiscard]] Eigen::Vector3d fibonacci_point(int index, int count);

/// How far the LiDAR is knocked, in its own frame, at each of `count` starts (paper, Sec. "Experiments"): the
/// components of the points of a Fibonacci sphere, times the range, are (roll, pitch, yaw) and, with
/// `with_translation`, those of another point of it are (x, y, z): its points in a shuffled order, always the same one,
/// so that the directions of the two have nothing to do with each other. With any orientation the rotation is drawn
/// uniformly from SO(3) (Shoemake 1992) by `seed`, which matters for nothing else.
[[nodiscard]] std::vector<RigidTransform> starting_motions(const ErrorRange& range, bool with_translation, int count,
                                                           std::uint64_t seed);

/// Limits for a search from such starts: wider than they are, so that they do not give the answer away.
/// 1.25 times the range, and 1 degree and 10 cm.
[[nodiscard]] SearchBounds search_bounds(const ErrorRange& range);

/// How far from the true extrinsic such a search may get: what features must be good for.
[[nodiscard]] SearchBounds reach(const ErrorRange& range);

}  // namespace calib::eval
