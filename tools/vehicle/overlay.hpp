#pragma once

#include <filesystem>

#include "calib/camera.hpp"
#include "calib/frame.hpp"
#include "calib/geometry.hpp"
#include "calib/result.hpp"

namespace calib::vehicle {

/// Writes the image of `pair` with every visible LiDAR point of it as a dot, coloured by its range (near red,
/// far blue). Fails with `write_failed`.
[[nodiscard]] Result<void> write_overlay(const std::filesystem::path& file, const FramePair& pair,
                                         const Camera& camera, const RigidTransform& T_camera_lidar);

}  // namespace calib::vehicle
