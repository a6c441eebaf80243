#pragma once

#include <optional>

#include "calib/depth_stereo.hpp"
#include "dds/decode.hpp"

namespace calib {

/// The last CameraInfo of the camera (`left`) and, with a stereo camera, of the right one.
struct StereoCameraInfo {
  std::optional<CameraInfo> left, right;
};

/// The right camera from the CameraInfo of both. Rectified images (`left` is `rectified`) need only the P of the right
/// one; all others need K, D, R and P of the right one and R of the left one. Fails with `bad_camera`.
[[nodiscard]] Result<RightCamera> right_camera(const Camera& left, const StereoCameraInfo& infos);

}  // namespace calib
