#pragma once

#include <filesystem>

#include "calib/depth.hpp"
#include "calib/frame.hpp"
#include "calib/geometry.hpp"

namespace calib {

/// Writes the image of `pair` with its visible LiDAR points as dots, coloured by range (near red, far blue), where they
/// are dense only some of them; and below it `depth`, when given, in the same colours by rank, black where there is
/// none. The extension of `file` says which kind of picture: .png or .jpg. Fails with
/// `write_failed`.
[[nodiscard]] Result<void> write_overlay(const std::filesystem::path& file, const FramePair& pair, const Camera& camera,
                                         const RigidTransform& T_camera_lidar, const DepthMap* depth = nullptr);

}  // namespace calib
