#pragma once

#include <memory>

#include "calib/depth.hpp"

namespace calib {

/// Metric inverse depth from a rectified stereo pair by OpenCV's semi-global matching (Hirschmueller 2008), with
/// left-right check; unsure and unmatched pixels have no depth. The disparity range follows the image's width.
/// `baseline_m` is the distance between the cameras. Fails with `bad_camera` when it is not within 1 mm .. 10 m or the
/// camera is not rectified.
[[nodiscard]] Result<std::unique_ptr<DepthEstimator>> make_stereo_depth(const Camera& camera, double baseline_m);

}  // namespace calib
