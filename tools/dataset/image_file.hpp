#pragma once

#include <filesystem>

#include "calib/frame.hpp"
#include "calib/result.hpp"

namespace calib {

/// Whether `Image::rgb` is filled too, where the file has colour.
enum class Colours { grey, rgb };

/// Reads an image of any format that OpenCV knows; the stamp is left at 0. Fails with `image_unreadable`.
[[nodiscard]] Result<Image> read_image(const std::filesystem::path& path, Colours colours = Colours::grey);

/// Writes `.png`. Fails with `write_failed`.
[[nodiscard]] Result<void> write_image(const std::filesystem::path& path, const Image& image);

}  // namespace calib
