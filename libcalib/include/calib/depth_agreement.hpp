#pragma once

#include <cstddef>
#include <optional>

#include "calib/depth.hpp"
#include "calib/frame.hpp"
#include "calib/geometry.hpp"

namespace calib {

/// How an image's depth and a scan agree at the pixels that the points project to.
struct DepthAgreement {
  /// Spearman's rank correlation of the depth of pixels with that of the points on them, -1 .. 1. At the right
  /// extrinsic good depth has 0.8 and more; no relation gives 0, and inverted depth a negative value.
  double rank_correlation = 0;
  /// Median of a point's depth times the inverse depth of its pixel: 1 where both are metric and right.
  double scale = 0;
  std::size_t points = 0;  // on a pixel with depth
};

/// Of an even sample of at most 20000 points. Nothing when fewer than `min_agreeing_points` of them project to a
/// pixel with depth.
[[nodiscard]] std::optional<DepthAgreement> depth_agreement(const DepthMap& depth, const Camera& camera,
                                                            const RigidTransform& T_camera_lidar,
                                                            const LidarScan& scan);
inline constexpr std::size_t min_agreeing_points = 100;

}  // namespace calib
