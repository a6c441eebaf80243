#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>

#include "calib/result.hpp"

namespace calib {

// JPEG and PNG, by libjpeg and libpng directly: OpenCV's codecs write to standard error, read past the last pixel, do
// not limit their memory, and bring along more than a hundred libraries for formats that are not needed.

enum class Compression { jpeg, png };

/// The format by the first bytes; nothing when they begin neither as a JPEG nor as a PNG.
[[nodiscard]] std::optional<Compression> compression_of(std::span<const std::uint8_t> bytes);

/// Pixels, row-major, without padding, with 1 (grey) or 3 (RGB) channels of 8 bits.
struct PixelLayout {
  int width = 0, height = 0, channels = 1;
  /// Decoding a PNG of 16 bits: channels of 16 bits, the high byte first.
  bool words = false;
  [[nodiscard]] std::size_t row_bytes() const { return static_cast<std::size_t>(width) * channels * (words ? 2 : 1); }
  [[nodiscard]] std::size_t bytes() const { return row_bytes() * height; }
};

/// Decodes into `out`, which has the size of `layout`; the image's own width and height must be those of `layout`.
/// Takes no more memory than a progressive JPEG of that size needs. The time is bounded only if the caller has bounded
/// the number of scans of a JPEG. Reduces 16 bits to 8 (unless the layout has words), drops transparency, and ignores
/// an EXIF orientation. Fails with `malformed:compressed_data` or `out_of_memory`.
[[nodiscard]] Result<void> decode_pixels(std::span<const std::uint8_t> bytes, Compression compression,
                                         const PixelLayout& layout, std::span<std::uint8_t> out);

/// Encodes `pixels`, which have the size of `layout`, as a file: a PNG compressed for speed, or a JPEG of quality 95.
/// Fails with `write_failed`: too large for the format, or no memory.
[[nodiscard]] Result<std::string> encode_pixels(std::span<const std::uint8_t> pixels, const PixelLayout& layout,
                                                Compression compression);

}  // namespace calib
