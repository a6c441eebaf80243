#pragma once

#include "calib/camera.hpp"
#include "calib/frame.hpp"
#include "calib/geometry.hpp"
#include "calib/result.hpp"

namespace calib {

/// Whether `T_camera_lidar` can be what its name says: from the LiDAR's frame (z up) to the camera's optical frame.
///
/// Fails with `extrinsic_implausible` when hardly any point of `scan` is in view, or when it sets the camera on its
/// side and another convention sets it upright with the points about as much in view: the inverse, a camera's body
/// frame (x forward, y left, z up), or both. The message names the one that fits best. A camera that is mounted on its
/// side or upside down passes: no other convention sets it upright.
[[nodiscard]] Result<void> check_extrinsic(const Camera& camera, const RigidTransform& T_camera_lidar,
                                           const LidarScan& scan);

}  // namespace calib
