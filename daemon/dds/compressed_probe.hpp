#pragma once

#include <cstdint>
#include <span>

#include "calib/image_codec.hpp"
#include "calib/result.hpp"
#include "dds/image_bound.hpp"

namespace calib {

// Checks of a JPEG or PNG before it is decoded. A few bytes may make a decoder work for minutes and allocate gigabytes.

struct CompressedHeader {
  Compression compression = Compression::jpeg;
  ImageSize size;
  int channels = 3;  // 1: grey; without transparency
  int bits = 8;      // 16 of a PNG with more than 8
};

/// The format by the first bytes, and the rest from the header. Fails with `malformed:compressed_format`, which names
/// some other formats, `malformed:depth_encoding` where a depth image shows, or `malformed:compressed_dimensions`.
[[nodiscard]] Result<CompressedHeader> probe_compressed(std::span<const std::uint8_t> bytes);

/// A progressive JPEG has about 10 scans, one with a scan per colour has 3. A decoder visits the whole image in each.
inline constexpr int max_jpeg_scans = 32;
/// Of all chunks of a PNG that hold no pixels.
inline constexpr std::size_t max_png_metadata_bytes = 1 << 20;
/// Number of compressed chunks of metadata: libpng decompresses each.
inline constexpr int max_png_compressed_metadata = 4;

/// Reads all bytes once and allocates nothing. Fails with
/// - `malformed:compressed_format`: a variant that cameras do not send (arithmetic, lossless or hierarchical JPEG,
///   several frames, four colours, an animated PNG);
/// - `malformed:compressed_scans` or `malformed:compressed_metadata`: more than the bounds above;
/// - `malformed:compressed_data`: incomplete.
[[nodiscard]] Result<void> check_compressed(std::span<const std::uint8_t> bytes, const CompressedHeader& header);

}  // namespace calib
