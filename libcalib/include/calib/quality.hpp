#pragma once

#include <limits>

#include "calib/depth.hpp"
#include "calib/frame.hpp"
#include "calib/geometry.hpp"

namespace calib {

/// Where metric depth can be believed. The default takes whatever there is.
struct DepthRange {
  double min_m = 0;
  double max_m = std::numeric_limits<double>::infinity();
};

/// What a pair must have to be evaluated. Each limit has the error code of its refusal.
struct QualityLimits {
  /// `motion`: how far the vehicle may have turned between image and scan, rad, where its turn rate is known. The
  /// extrinsic seems to be off by as much.
  double max_turn_rad = 0.1 * radians_per_degree;
  double min_mean_grey = 20;         // `dark`: 0 .. 255
  double max_saturated_share = 0.4;  // `saturated`: of pixels at 250 and above
  double min_texture = 3;            // `low_texture`: mean absolute grey difference of pixels four apart
  double min_scene_change = 2;       // `standing_still`: mean absolute grey difference to the last evaluated image
  double min_valid_depth = 0.15;     // `few_valid_depth`: share of the image
  DepthRange depth_range;            // depth outside it is none
  int min_points = 1000;             // `low_overlap`: LiDAR points that project to valid depth
};

/// A small thumbnail of an image, to detect that the vehicle has not moved.
struct SceneThumbnail {
  std::vector<std::uint8_t> grey;
};
[[nodiscard]] SceneThumbnail thumbnail(const Image& image);

/// How little two images have in common: 0 when they are the same but for brightness and contrast, about 1 when they
/// are unrelated, at most 2 (one less the correlation of the thumbnails).
[[nodiscard]] double scene_change(const SceneThumbnail& a, const SceneThumbnail& b);

/// Checks, in the order in which they are cheap, all that can be known before depth is computed: `image_size_mismatch`
/// (not the camera's), `motion`, `dark`, `saturated`, `low_texture`, `standing_still` (against `last`, when there is
/// one), `low_overlap` (no points).
[[nodiscard]] Result<void> check_pair(const FramePair& pair, const Camera& camera, const SceneThumbnail* last,
                                      const QualityLimits& limits);

/// Removes the depth of pixels where it is out of range, and where the image is saturated or black over more than a
/// pixel or two, so that no depth can be measured there. Fails with `image_size_mismatch`, and takes nothing, where
/// `depth` is not of the image's size.
[[nodiscard]] Result<void> mask_depth(const Image& image, const DepthRange& range, DepthMap& depth);

/// `few_valid_depth`.
[[nodiscard]] Result<void> check_depth(const DepthMap& depth, const QualityLimits& limits);

}  // namespace calib
