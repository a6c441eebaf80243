#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "calib/camera.hpp"
#include "calib/depth.hpp"
#include "calib/frame.hpp"
#include "calib/geometry.hpp"

namespace calib {

/// How far from the current extrinsic a feature set must stay usable; points further out of view are culled.
struct SearchBounds {
  double rotation_rad = 5 * radians_per_degree;  // per axis; from one radian on no point is culled
  double translation_m = 0.5;                    // per axis
};

/// The projection of a feature set's pixels, chosen so that a point costs one division whatever the real lens is:
/// u = fx x / (z + xi d) + cx, d the point's distance. `xi` is 0 (pinhole) for cameras that see less than 60 degrees
/// off their axis, else 1 (stereographic), which takes in everything but straight behind. Images are resampled into it
/// once per pair: of a rectified image every n-th pixel of every n-th row. n is as large as leaves a pixel of the grid
/// at most 0.17 degrees wide, and the grid at least 480 x 16 pixels; 2 for KITTI's images.
struct BearingGrid {
  int width = 0, height = 0;
  float fx = 0, fy = 0, cx = 0, cy = 0;
  float xi = 0;

  [[nodiscard]] static BearingGrid of(const Camera& camera);
  /// Unit bearing (optical frame) of a pixel.
  [[nodiscard]] Eigen::Vector3d bearing(double u, double v) const;
  [[nodiscard]] std::size_t pixels() const { return static_cast<std::size_t>(width) * height; }
};

/// What `make_features` prepares, by what it serves.
struct FeatureSettings {
  SearchBounds bounds{};
  /// Fewer points than this on pixels with depth at the given extrinsic are refused.
  int min_points = 1000;
  /// Also the features that only the published methods need.
  bool baselines = false;
};

/// Where a packed pixel holds the class of a feature: `bits` bits from `shift` on, 2^class_shift ranks a class, all
/// bits set where the pixel has no value.
struct PackedClass {
  int shift, bits, class_shift;
  [[nodiscard]] constexpr unsigned mask() const { return (1U << bits) - 1; }
  /// `pixel` with the class of `rank` (255: no value) in it.
  [[nodiscard]] constexpr std::uint16_t put(std::uint16_t pixel, std::uint8_t rank) const {
    return static_cast<std::uint16_t>((pixel & ~(mask() << shift)) | static_cast<unsigned>(rank >> class_shift)
                                                                         << shift);
  }
  /// The lowest rank of the pixel's class, 255 when it has no value.
  [[nodiscard]] constexpr std::uint8_t rank(std::uint16_t pixel) const {
    const unsigned found = pixel >> shift & mask();
    return static_cast<std::uint8_t>(found == mask() ? 255 : found << class_shift);
  }
};

/// How much the brightness changes from left to right, in cells of several pixels: ranks among the cell's tile of the
/// image, row-major, `FeatureSet::none` where the image has no value. A cell is as wide as what a LiDAR resolves.
struct ContrastPlane {
  static constexpr float cell_rad = 0.0028F;
  int width = 0, height = 0;            // cells
  int cell_columns = 1, cell_rows = 1;  // pixels of the grid in a cell
  std::vector<std::uint8_t> rank;
};

/// What is kept of an image and its depth: planes of the grid, row-major, `grid.pixels()` values or empty.
struct FeaturePlanes {
  BearingGrid grid;
  /// Depth among the whole image, depth among its tile of 8 x 3, and brightness: so that a point reads memory once.
  static constexpr PackedClass depth{0, 6, 2}, tile_depth{6, 5, 3}, grey{11, 5, 3};
  std::vector<std::uint16_t> packed;
  /// Baselines: the paper's features in classes of equal width, depth along the axis and brightness; and the full ranks
  /// of brightness.
  std::vector<std::uint8_t> depth_linear, grey_linear, grey_rank;
  ContrastPlane contrast;
  /// Of the camera: nothing further off its axis is visible.
  double max_angle_rad = 0;
};

/// What is kept of a pair: everything that the objectives need, and no image. About 0.6 MB for a 1242 x 375 image and a
/// 64-beam scan. A copy shares the planes.
///
/// A feature is a rank: the value's place among all values of the frame in equal steps 0 .. 239 (a histogram with equal
/// populations). Ranks do not change under any monotone distortion, so relative inverse depth of unknown scale serves
/// as well as metres. Classes of 4, 8 or 16 ranks divide their number evenly, and `none` falls into a class of its own.
/// Depth is compared as the LiDAR measures it, as distance along the ray from the camera and not along its axis: else
/// the relation between the two would change over the image. All ranks of distance grow with it.
struct FeatureSet {
  static constexpr int ranks = 240;
  static constexpr std::uint8_t none = 255;
  static constexpr int tile_columns = 8, tile_rows = 3;

  Timestamp stamp{};
  std::shared_ptr<const FeaturePlanes> planes;
  /// Points in the LiDAR frame, in units of `unit_m`, that can be in view within the bounds. Every 32nd comes first,
  /// then what makes that every 16th, and so on: the first 1 / 2^n of them are an even sample of all.
  std::vector<std::int16_t> x, y, z;
  /// A power of two, as small as the scan's largest coordinate permits: 4 mm up to 128 m, 16 mm up to `farthest_m`.
  float unit_m = 1;
  /// What lies further away is no measurement, and is left out.
  static constexpr float farthest_m = 511;
  /// Ranks of a point's distance from the camera, and of its reflectance. The camera's position is that of the given
  /// extrinsic, which is good enough within a degree and some centimetres of it. From bounds of one radian on the
  /// position is unknown, and the distance is that from the LiDAR.
  std::vector<std::uint8_t> range_rank, reflectance_rank;
  /// The paper's: Euclidean range in the LiDAR frame, reflectance.
  std::vector<std::uint8_t> range_linear, reflectance_linear;
  /// Those of the points that are at the near side of a jump of range to their left or right, in the same units.
  std::vector<std::int16_t> edge_x, edge_y, edge_z;

  [[nodiscard]] std::size_t points() const { return x.size(); }
  /// In the LiDAR frame, in m.
  [[nodiscard]] Eigen::Vector3f point(std::size_t i) const { return unit_m * Eigen::Vector3f(x[i], y[i], z[i]); }
  /// Rounds points (LiDAR frame, m) to units that suit coordinates up to `largest_m`, which none exceeds, and keeps
  /// them.
  void set_points(std::span<const Eigen::Vector3f> points, float largest_m);
  [[nodiscard]] std::size_t memory_bytes() const;

  /// The same pair for a search about another extrinsic, of points that can be in view within narrower bounds.
  [[nodiscard]] FeatureSet about(const RigidTransform& T_camera_lidar, const SearchBounds& bounds) const;
};

/// Features of one pair. `T_camera_lidar` decides which points are culled and where their distance is taken from.
/// Fails with `depth_failed` when `depth` is not of the camera's size, with `low_overlap` when fewer than
/// `settings.min_points` points project to valid depth at `T_camera_lidar`.
[[nodiscard]] Result<FeatureSet> make_features(const FramePair& pair, const DepthMap& depth, const Camera& camera,
                                               const RigidTransform& T_camera_lidar,
                                               const FeatureSettings& settings = {});

}  // namespace calib
