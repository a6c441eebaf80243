#pragma once

#include "calib/search.hpp"

namespace calib {

/// How far the LiDAR has moved in its own frame (rad, m), as estimated.
struct Misalignment {
  Vector6 delta = Vector6::Zero();
  Matrix6 covariance = Matrix6::Zero();

  [[nodiscard]] Vector6 sigma() const { return covariance.diagonal().cwiseSqrt(); }
};

inline constexpr std::size_t fewest_misalignment_frames = 8;

/// Where the optimum over `frames` lies, seen from `T_camera_lidar`: by the default method, within `settings.bounds`.
/// The rotation alone with monocular depth, which does not show the translation, and where all six axes neither score
/// surely better nor find a significant one; what they find for the translation is then part of its variance. The
/// covariance is that of the bootstrap, for few frames, and what searches from different starts scatter by. Axes that
/// are not searched, and those that these frames do not show, are as uncertain as the bounds are wide. Fails as
/// `search` does, with `too_few_pairs`, and with `search_failed` where the optimum is beyond the bounds.
[[nodiscard]] Result<Misalignment> find_misalignment(Frames frames, const RigidTransform& T_camera_lidar,
                                                     const SearchSettings& settings);

}  // namespace calib
