#pragma once

#include <cstddef>
#include <span>
#include <vector>

#include "calib/features.hpp"

namespace calib {

/// Indices of the points where what they are on ends to the left or right, as the camera sees it: at the near side of a
/// jump of range, or with no measurement beside them. These are the outlines of things, as far as the LiDAR's spacing
/// resolves them. The order of the points has no meaning, so that it works
/// with scans that are not organised by rings. `points` in the LiDAR frame (m).
[[nodiscard]] std::vector<std::size_t> range_edges(std::span<const Eigen::Vector3f> points,
                                                   const RigidTransform& T_camera_lidar);

/// Of the brightness at each pixel of a grid (NaN: none).
[[nodiscard]] ContrastPlane contrast_of(const std::vector<float>& grey, const BearingGrid& grid);

}  // namespace calib
