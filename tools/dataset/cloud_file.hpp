#pragma once

#include <filesystem>

#include "calib/frame.hpp"
#include "calib/result.hpp"

namespace calib {

/// Reads a LiDAR scan: `.bin` (32-bit floats x, y, z, reflectance, as KITTI) or `.pcd` (ASCII or binary; fields x, y, z
/// and, where there is one, intensity or reflectance, of any PCD type). Metres. Points that are not finite, beyond
/// 500 m, or at the LiDAR's own origin (how drivers mark "no return") are left out; the stamp is left at 0.
/// Fails with `cloud_unreadable` (also over 256 MiB), or `cloud_empty` when no point is left.
[[nodiscard]] Result<LidarScan> read_cloud(const std::filesystem::path& path);

/// Writes `.bin`. Fails with `write_failed`.
[[nodiscard]] Result<void> write_cloud(const std::filesystem::path& path, const LidarScan& scan);

}  // namespace calib
