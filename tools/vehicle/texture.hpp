#pragma once

#include <cstdint>
#include <vector>

#include "vehicle/mesh.hpp"

namespace calib::vehicle {

/// Fractal noise that repeats every `period_m`, averaged beforehand over every size of footprint (powers of
/// two in u and v apart), so that a road seen at a grazing angle keeps the detail across while it loses that
/// along: both cameras of a stereo pair then see the same brightness of the same place.
class NoiseTexture {
 public:
  static constexpr float texel_m = 0.015f;
  static constexpr float period_m = texel_m * 512;

  explicit NoiseTexture(std::uint64_t seed);

  /// Noise of mean 0 and standard deviation about 1 at full detail, averaged over about `du` x `dv` (metres)
  /// around (u, v).
  [[nodiscard]] float at(float u, float v, float du, float dv) const;

 private:
  static constexpr int levels = 10;
  static constexpr int size = 512;
  // levels_[lv][lu]: size >> lu columns, size >> lv rows.
  std::vector<float> maps_[levels][levels];
};

/// Albedo in [0, 1] of the place (u, v) of `surface`, averaged over a footprint of about `du` x `dv`; all
/// metres.
[[nodiscard]] float albedo(const NoiseTexture& noise, Surface surface, float u, float v, float du, float dv);

}  // namespace calib::vehicle
