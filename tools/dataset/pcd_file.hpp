#pragma once

#include <filesystem>
#include <string_view>

#include "calib/frame.hpp"
#include "calib/result.hpp"

namespace calib {

/// Reads the content of a `.pcd` file as `read_cloud` says.
[[nodiscard]] Result<LidarScan> read_pcd(std::string_view bytes, const std::filesystem::path& path);

}  // namespace calib
