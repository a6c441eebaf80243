#pragma once

#include <filesystem>

#include "calib/result.hpp"
#include "vehicle/render.hpp"

namespace calib::vehicle {

/// One picture of a place that is like no other: what a depth network has to have seen before it meets real streets.
/// Towns, country roads, forests and open fields; a camera 1.2 to 2.2 m above the road with 40 to 110 degrees across,
/// pitched, rolled and turned; low and high sun, hard shadows and overcast, all sorts of exposure.
struct VariedView {
  Camera camera;  // rectified
  Rendering rendering;
  Image image;
};

/// View `index` of the world `seed`, which depends on nothing else but the size (pixels). `noise` is what all
/// textures are made of.
[[nodiscard]] VariedView varied_view(const NoiseTexture& noise, std::uint64_t seed, std::size_t index, int width,
                                     int height);

/// Writes views 0 .. count - 1 as `images/NNNNNN.png` and `depth/NNNNNN.png` below `folder`, the latter as 16-bit
/// depth along the optical axis (m / 256; 0: sky, or beyond 256 m). Fails with `write_failed`.
[[nodiscard]] Result<void> dump_varied_views(const std::filesystem::path& folder, std::uint64_t seed, std::size_t count,
                                             int width, int height);

}  // namespace calib::vehicle
