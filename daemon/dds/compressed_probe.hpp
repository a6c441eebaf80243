#pragma once

#include <cstdint>
#include <span>

#include "calib/result.hpp"
#include "dds/image_bound.hpp"

namespace calib {

/// What can be known of a JPEG or PNG before a decoder sees it: a few bytes may ask for minutes and for gigabytes.

enum class Compression { jpeg, png };

struct CompressedHeader {
  Compression compression = Compression::jpeg;
  ImageSize size;
};

/// By the first bytes, and the size as the header has it. Fails with `malformed:compressed_format` or
/// `malformed:compressed_dimensions`.
[[nodiscard]] Result<CompressedHeader> probe_compressed(std::span<const std::uint8_t> bytes);

/// A progressive JPEG has about 10, one of each colour alone 3; each goes over the whole image.
inline constexpr int max_jpeg_scans = 32;
/// What a PNG holds beside its pixels.
inline constexpr std::size_t max_png_metadata_bytes = 1 << 20;
/// Of metadata that libpng decompresses.
inline constexpr int max_png_compressed_metadata = 4;

/// Goes over all of it once and takes no memory. Fails with `malformed:compressed_format` (a kind that no camera sends:
/// arithmetic, lossless or hierarchical JPEG, several frames, four colours, an animated PNG),
/// `malformed:compressed_scans`, `malformed:compressed_metadata`, or `malformed:compressed_data` (not whole).
[[nodiscard]] Result<void> check_compressed(std::span<const std::uint8_t> bytes, const CompressedHeader& header);

}  // namespace calib
