#pragma once

#include <memory>
#include <optional>

#include "calib/depth.hpp"
#include "calib/geometry.hpp"

namespace calib {

/// A depth camera with optics of its own. `T_camera_depth` maps points of its frame into the camera's.
struct DepthCamera {
  Camera camera;
  RigidTransform T_camera_depth = RigidTransform::Identity();
};

/// Depth that came with the pair (`FramePair::depth`), put into the pixels of `camera`'s image. Without `own`, the
/// depth image shows what the image shows: of the same size it is taken as it is, of another size (sides in the same
/// proportion, to 1 %) each pixel takes the nearest one. With `own`, each of its pixels is carried into the camera,
/// where the nearest surface wins and covers as many pixels as the two focal lengths ask for; what only the camera
/// sees stays without depth. Either way nothing is interpolated: between a near and a far surface there is none.
/// Estimating fails with `depth_failed`, when depth is missing or of another shape.
[[nodiscard]] std::unique_ptr<DepthEstimator> make_topic_depth(const Camera& camera,
                                                               const std::optional<DepthCamera>& own);

}  // namespace calib
