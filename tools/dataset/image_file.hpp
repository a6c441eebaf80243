#pragma once

#include <filesystem>

#include "calib/frame.hpp"
#include "calib/result.hpp"

namespace calib {

/// Reads an image of any format that OpenCV knows as grey; the stamp is left at 0. Fails with `image_unreadable`.
[[nodiscard]] Result<Image> read_image(const std::filesystem::path& path);

/// Writes `.png`. Fails with `write_failed`.
[[nodiscard]] Result<void> write_image(const std::filesystem::path& path, const Image& image);

}  // namespace calib
