#pragma once

#include <cstdint>
#include <optional>
#include <string_view>

namespace calib {

/// What an encoded image says of itself before anything of it is decoded.
struct ImageHeader {
  static constexpr std::int64_t most_pixels = 64'000'000;
  static constexpr int most_scans = 100;  // of a JPEG, each of which costs as much time as the first

  std::int64_t width = 0, height = 0;
  int scans = 1;
  /// False for a JPEG without an end of image behind its scans: decoders fill the rest of its pixels with grey. What
  /// follows that end does not matter.
  bool complete = true;
  /// Whether decoding it takes bounded memory and time.
  [[nodiscard]] bool in_bounds() const {
    return width >= 1 && height >= 1 && width <= most_pixels && height <= most_pixels / width && scans <= most_scans;
  }
};

/// The header of a PNG, JPEG, TIFF, BMP, PBM, PGM, PPM or PFM; nothing when `bytes` begin as none of those, or break
/// off.
[[nodiscard]] std::optional<ImageHeader> read_image_header(std::string_view bytes);

}  // namespace calib
