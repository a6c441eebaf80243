#pragma once

#include <filesystem>
#include <optional>
#include <utility>

#include "calib/frame.hpp"
#include "calib/result.hpp"

namespace calib {

/// Whether `Image::rgb` is filled too, where the file has colour.
enum class Colours { grey, rgb };

/// Reads a PNG, JPEG, TIFF, BMP or PNM of up to 256 MiB and 64 Mpx; the stamp is left at 0. Of 16-bit values 0 ..
/// 2^`bits` - 1 becomes 0 .. 255, and values that seem to have fewer bits are remarked (`image_bits`). Fails with
/// `image_unreadable`, and before anything is decoded when it has another size than `size`, its camera's.
[[nodiscard]] Result<Image> read_image(const std::filesystem::path& path, Colours colours = Colours::grey,
                                       std::optional<std::pair<int, int>> size = std::nullopt, int bits = 16);

/// Writes `.png`. Fails with `write_failed`.
[[nodiscard]] Result<void> write_image(const std::filesystem::path& path, const Image& image);

}  // namespace calib
