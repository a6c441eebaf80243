#pragma once

#include <cstdint>
#include <span>

#include "calib/result.hpp"
#include "dds/compressed_probe.hpp"

namespace calib {

/// Decodes a JPEG or PNG that `check_compressed` has accepted into `out`: 8 bit, row-major, without padding, with 1
/// (grey) or 3 (RGB) `channels`, for which `out` has the exact size. Calls libjpeg and libpng directly: OpenCV's
/// decoders write to standard error, read past the last pixel and do not limit their memory. Fails with
/// `malformed:compressed_data` or `out_of_memory`.
[[nodiscard]] Result<void> decompress(std::span<const std::uint8_t> bytes, const CompressedHeader& header, int channels,
                                      std::span<std::uint8_t> out);

}  // namespace calib
