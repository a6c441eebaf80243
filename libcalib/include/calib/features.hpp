#pragma once

#include <cstdint>
#include <vector>

#include "calib/depth.hpp"
#include "calib/geometry.hpp"
#include "calib/frame.hpp"

namespace calib {

/// How far from the current extrinsic a feature set must stay usable; points further out of view are culled.
struct SearchBounds {
  double rotation_rad = 5 * radians_per_degree;  // per axis
  double translation_m = 0.5;                    // per axis
};

/// What is kept of a pair: everything the mutual information needs, and no image. About 1 MB for a 1242 x 375 image
/// and a 64-beam scan.
///
/// Both features are ranks: the value's place among all values of the frame in equal steps 0 .. 251 (a histogram with
/// equal populations). Ranks do not change under any monotone distortion of the distance along the ray, so relative
/// inverse depth of unknown scale serves as well as metres. Nearer is a smaller range and a larger inverse depth;
/// `depth_rank` is turned round so that both ranks grow with distance.
struct FeatureSet {
  static constexpr int ranks = 252;
  static constexpr std::uint8_t no_depth = 255;

  Timestamp stamp{};
  /// The pinhole camera of `depth_rank`; where the real camera has distortion, depth was resampled into this one.
  int width = 0, height = 0;
  float fx = 0, fy = 0, cx = 0, cy = 0;
  /// Row-major, `no_depth` where there is none.
  std::vector<std::uint8_t> depth_rank;
  /// Points in the LiDAR frame (m) that can be in view within the bounds, and the rank of their range (paper, Sec.
  /// "Algorithm": Euclidean distance to the LiDAR's origin, which no extrinsic changes).
  std::vector<float> x_m, y_m, z_m;
  std::vector<std::uint8_t> range_rank;

  [[nodiscard]] std::size_t memory_bytes() const;
};

/// Features of one pair. `T_camera_lidar` and `bounds` only decide which points are culled.
/// Fails with `low_overlap` when fewer than `min_points` points land on valid depth at `T_camera_lidar`.
[[nodiscard]] Result<FeatureSet> make_features(const DepthMap& depth, const LidarScan& scan, const Camera& camera,
                                               const RigidTransform& T_camera_lidar, const SearchBounds& bounds,
                                               int min_points);

}  // namespace calib
