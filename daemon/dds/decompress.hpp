#pragma once

#include <cstdint>
#include <span>

#include "calib/result.hpp"
#include "dds/compressed_probe.hpp"

namespace calib {

/// The pixels of a JPEG or PNG that `check_compressed` has passed, by libjpeg and libpng themselves: unlike OpenCV's
/// decoders they then write nothing to standard error, read no further than the last pixel, and keep to bounds on
/// memory. 8 bit, row by row; `channels` is 1 for grey or 3 for RGB, and `out` has room for them all. Fails with
/// `malformed:compressed_data` or `out_of_memory`.
[[nodiscard]] Result<void> decompress(std::span<const std::uint8_t> bytes, const CompressedHeader& header, int channels,
                                      std::span<std::uint8_t> out);

}  // namespace calib
