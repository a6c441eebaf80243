#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "calib/depth.hpp"
#include "calib/frame.hpp"
#include "calib/geometry.hpp"

namespace calib {

/// What stands above a picture: its title, and lines of what it shows. Too long a line is cut.
struct OverlayCaption {
  std::string title;
  std::vector<std::string> lines = {};
};

/// Writes the image of `pair` with its visible LiDAR points as dots, coloured by range (near red, far blue), where they
/// are dense only some of them; and below it `depth`, when given, in the same colours by rank, black where there is
/// none. With a caption, there is a legend of the colours, too: ranges in metres above the image, and a line above the
/// depth. The extension of `file` says which kind of picture: .png or .jpg. Fails with `write_failed`.
[[nodiscard]] Result<void> write_overlay(const std::filesystem::path& file, const FramePair& pair, const Camera& camera,
                                         const RigidTransform& T_camera_lidar, const DepthMap* depth = nullptr,
                                         const OverlayCaption* caption = nullptr);

}  // namespace calib
