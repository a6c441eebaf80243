#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <string_view>

#include "calib/camera.hpp"
#include "calib/depth.hpp"
#include "calib/result.hpp"

namespace calib {

/// What the values of a depth file are.
enum class DepthKind {
  disparity,  // pixels of the file's own width; metric where the baseline is known, else up to a factor
  inverse,    // inverse depth of any positive scale, larger is nearer
  depth,      // metres (or any unit) along the optical axis
  range,      // metres (or any unit) along the ray: for cameras that see sideways and beyond
};

/// Fails with `unknown_depth_kind`.
[[nodiscard]] Result<DepthKind> parse_depth_kind(std::string_view name);

/// A folder with one depth map for every frame: `<frame name>.png` (16 bit), `.tif`, `.tiff`, `.pfm` (one channel of
/// 32-bit floats) or `.npy` (two-dimensional, little-endian float32, C order). A value of 0 or below, or one that is
/// not finite, is no depth. Files of up to 256 MiB and 64 Mpx are read.
struct DepthFolder {
  std::filesystem::path folder;
  DepthKind kind = DepthKind::disparity;
  /// What is stored divided by this is the value. Default: 256 for 16-bit files, 1 for floats.
  std::optional<double> scale;
};

/// The depth of one frame as an inverse depth of the image's size; another size of the same aspect is resized to it
/// (nearest neighbour: between an edge's two sides there is no depth). `baseline_m` matters for `disparity` only.
/// Fails with `depth_missing`, `depth_unreadable` (also another aspect) or `depth_empty` (no valid value).
[[nodiscard]] Result<DepthMap> read_depth(const DepthFolder& depth, const std::string& frame_name, const Camera& camera,
                                          std::optional<double> baseline_m);

/// Multiplies every depth by 1 + f(u, v), as a biased depth network would: f is a random polynomial of degree 1 .. 3
/// over the image with max |f| = `amplitude`, 0 <= amplitude < 1. The same seed gives the same field.
void add_smooth_bias(DepthMap& depth, double amplitude, std::uint64_t seed);

/// Writes ranges (m, along the ray, row-major) as a 16-bit PNG with scale 256: steps of 4 mm, none beyond 256 m.
/// Fails with `write_failed`.
[[nodiscard]] Result<void> write_range_png(const std::filesystem::path& path, int width, int height,
                                           const std::vector<float>& range_m);

}  // namespace calib
