#pragma once

#include <memory>

#include "calib/depth.hpp"
#include "calib/geometry.hpp"

namespace calib {

/// The second camera of a stereo pair, and where it stands: `T_right_left` maps points of the left camera's frame into
/// the right one's.
struct RightCamera {
  Camera camera;
  RigidTransform T_right_left = RigidTransform::Identity();
};

/// Of a rectified pair: the left camera again, `baseline_m` to its right.
[[nodiscard]] inline RightCamera rectified_right_camera(const Camera& left, double baseline_m) {
  return {left, RigidTransform(Eigen::Translation3d(-baseline_m, 0, 0))};
}

/// How matching pixels are found: `sgbm`, semi-global matching (Hirschmueller 2008), or `bm`, block matching, several
/// times quicker, with depth for textured places only. Both are OpenCV's, with a left-right check.
enum class StereoMatcher { sgbm, bm };

/// Metric inverse depth along the left camera's optical axis, from a stereo pair. A rectified pair is matched as it is;
/// any other is rectified by the models of its two cameras, and depth is looked up for each pixel of the left image as
/// it came. Ambiguous and unmatched pixels, and what the rectified picture does not show (more than some 50 degrees off
/// the axis between the cameras), have no depth. The disparity range follows the image's width. Fails with
/// `bad_camera` when the cameras are not side by side, within 1 mm .. 10 m of each other, and looking the same way to
/// 30 degrees.
[[nodiscard]] Result<std::unique_ptr<DepthEstimator>> make_stereo_depth(const Camera& left, const RightCamera& right,
                                                                        StereoMatcher matcher = StereoMatcher::sgbm);

/// Of a rectified pair.
[[nodiscard]] Result<std::unique_ptr<DepthEstimator>> make_stereo_depth(const Camera& camera, double baseline_m);

}  // namespace calib
