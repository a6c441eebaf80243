#pragma once

#include <filesystem>
#include <optional>

#include "calib/cloud_layout.hpp"
#include "calib/frame.hpp"
#include "calib/result.hpp"

namespace calib {

/// Reads a LiDAR scan in metres: `.pcd` (ASCII, binary or binary_compressed; fields x, y, z and, where there is one,
/// one of `reflectance_names`, of any PCD type), or `.bin`, points of `layout`; without one they are taken for
/// float32x4 as KITTI has them, if they look so (`check_cloud_layout`). Points that are not finite, beyond 500 m, or at
/// the LiDAR's own origin (how drivers mark "no return") are left out; the stamp is left at 0. Fails with
/// `cloud_unreadable` (also over 256 MiB), `cloud_layout` when the bytes are not what they are taken for, or
/// `cloud_empty` when no point is left.
[[nodiscard]] Result<LidarScan> read_cloud(const std::filesystem::path& path,
                                           const std::optional<CloudLayout>& layout = std::nullopt);

/// Writes `.bin`. Fails with `write_failed`.
[[nodiscard]] Result<void> write_cloud(const std::filesystem::path& path, const LidarScan& scan);

}  // namespace calib
