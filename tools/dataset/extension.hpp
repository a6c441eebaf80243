#pragma once

#include <algorithm>
#include <filesystem>
#include <string>

namespace calib {

/// The extension in lower case: cameras and Windows write `.JPG` and `.PCD`.
[[nodiscard]] inline std::string extension_of(const std::filesystem::path& path) {
  std::string extension = path.extension().string();
  std::ranges::transform(extension, extension.begin(),
                         [](char c) { return c >= 'A' && c <= 'Z' ? static_cast<char>(c - 'A' + 'a') : c; });
  return extension;
}

}  // namespace calib
