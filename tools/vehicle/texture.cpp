#include "vehicle/texture.hpp"

#include <algorithm>
#include <bit>
#include <cmath>

#include "vehicle/street.hpp"

namespace calib::vehicle {
namespace {

/// floor(log2(x)) of a positive float, cut to [0, highest].
int level_of(float x, int highest) {
  const int exponent = static_cast<int>(std::bit_cast<std::uint32_t>(x) >> 23) - 127;
  return std::clamp(exponent, 0, highest);
}

/// Share of the footprint [x - w/2, x + w/2] that lies in [low, high].
float covered(float x, float low, float high, float w) {
  w = std::max(w, 1e-3f);
  return std::clamp((x - low) / w + 0.5f, 0.f, 1.f) - std::clamp((x - high) / w + 0.5f, 0.f, 1.f);
}

float blend(float from, float to, float share) { return from + (to - from) * share; }

/// The fraction `index` of surface's seed, uniform in [low, high]: one property of its look.
float trait(Surface surface, std::uint64_t index, float low, float high) {
  return low + (high - low) * unit(mix(surface.seed, index));
}

float road_albedo(float along, float across, float along_w, float across_w, float ground) {
  const float line = 0.85f;
  const float period = 6;
  const float phase = along - period * std::floor(along / period);
  const float dash = covered(phase, 1.5f, 4.5f, along_w);
  float result = blend(ground, line, dash * covered(across, -0.07f, 0.07f, across_w));
  // The edge of the parking lane, and wheel tracks polished by traffic.
  const float side = std::abs(across);
  result = blend(result, line, covered(side, Street::lane_edge_m - 0.06f, Street::lane_edge_m + 0.06f, across_w));
  return result * (1 - 0.15f * covered(side, 0.75f, 1.15f, across_w) - 0.15f * covered(side, 2.35f, 2.75f, across_w));
}

/// Rows of windows over a ground floor of shop windows; u from the building's edge, v from the ground.
float facade_albedo(Surface surface, float u, float v, float du, float dv, float wall) {
  const float column_m = trait(surface, 1, 2.1f, 3.3f), floor_m = trait(surface, 2, 2.8f, 3.4f);
  const float half_width = trait(surface, 3, 0.45f, 0.75f), height = trait(surface, 4, 1.2f, 1.9f);
  const float column = std::floor(u / column_m), floor = std::floor(v / floor_m);
  const float x = u - (column + 0.5f) * column_m, y = v - floor * floor_m;
  const bool ground_floor = floor < 0.5f;
  const float w = ground_floor ? 0.42f * column_m : half_width;
  const float low = ground_floor ? 0.5f : 0.8f, high = low + (ground_floor ? 1.9f : height);

  const std::uint64_t window =
      mix(surface.seed, static_cast<std::uint64_t>(column + 64), static_cast<std::uint64_t>(floor + 64));
  const float glass = unit(window) < 0.25f ? 0.5f + 0.3f * unit(mix(window)) : 0.04f + 0.16f * unit(mix(window));
  const float frame = trait(surface, 5, 0.f, 1.f) < 0.5f ? 0.85f : 0.25f;
  float result = wall;
  // A band between the floors, then frame, panes, and the bar between them.
  result = blend(result, 0.6f * wall + 0.3f, 0.7f * covered(y, floor_m - 0.2f, floor_m + 0.1f, dv));
  result = blend(result, frame, covered(x, -w - 0.1f, w + 0.1f, du) * covered(y, low - 0.12f, high + 0.1f, dv));
  result = blend(result, glass, covered(x, -w, w, du) * covered(y, low, high, dv));
  return blend(result, frame, covered(x, -0.04f, 0.04f, du) * covered(y, low, high, dv));
}

/// Slabs with dark joints.
float paving_albedo(float u, float v, float du, float dv, float stone) {
  const float x = u - 0.6f * std::floor(u / 0.6f), y = v - 0.6f * std::floor(v / 0.6f);
  const float joint_u = 1 - covered(x, 0.015f, 0.585f, du), joint_v = 1 - covered(y, 0.015f, 0.585f, dv);
  return stone * (1 - 0.35f * std::max(joint_u, joint_v));
}

/// Dark marks in rows, some left out, like writing.
float sign_albedo(Surface surface, float u, float v, float du, float dv) {
  constexpr float width = 0.12f, height = 0.2f;
  const float column = std::floor(u / width), row = std::floor(v / height);
  const std::uint64_t place =
      mix(surface.seed, static_cast<std::uint64_t>(column + 1024), static_cast<std::uint64_t>(row + 1024));
  if (unit(place) < 0.3f) return 0.8f;
  const float x = u - width * column, y = v - height * row;
  return blend(0.8f, 0.12f, covered(x, 0.02f, 0.1f, du) * covered(y, 0.05f, 0.16f, dv));
}

/// Two shades in stripes or checks, of a width and a slant of their own.
float pattern_albedo(Surface surface, float u, float v, float du, float dv) {
  const float one = trait(surface, 0, 0.03f, 0.9f), other = trait(surface, 1, 0.03f, 0.9f);
  const float period = std::exp(trait(surface, 2, -2.3f, 1.4f)), slant = trait(surface, 3, -1, 1);
  const auto share = [&](float at, float width) {
    return covered(at / period - std::floor(at / period), 0.25f, 0.75f, width / period);
  };
  const float stripes = share(u + slant * v, du + std::abs(slant) * dv);
  if (trait(surface, 4, 0, 1) < 0.5f) return blend(one, other, stripes);
  const float across = share(v - slant * u, dv + std::abs(slant) * du);
  return blend(one, other, stripes + across - 2 * stripes * across);
}

}  // namespace

NoiseTexture::NoiseTexture(std::uint64_t seed) {
  auto& full = maps_[0][0];
  full.assign(size * size, 0.f);
  Random random(seed);
  // Value noise, octave by octave; every octave about as strong, so that near and far surfaces both have
  // texture.
  for (int cell = 1; cell <= 128; cell *= 2) {
    const int count = size / cell;
    std::vector<float> lattice(count * count);
    for (float& value : lattice) value = random.uniform(-1, 1);
    for (int y = 0; y < size; ++y)
      for (int x = 0; x < size; ++x) {
        const int i = x / cell, j = y / cell, i1 = (i + 1) % count, j1 = (j + 1) % count;
        const float a = static_cast<float>(x % cell) / static_cast<float>(cell);
        const float b = static_cast<float>(y % cell) / static_cast<float>(cell);
        full[y * size + x] += blend(blend(lattice[j * count + i], lattice[j * count + i1], a),
                                    blend(lattice[j1 * count + i], lattice[j1 * count + i1], a), b);
      }
  }
  double square_sum = 0;
  for (const float value : full) square_sum += value * value;
  const float scale = static_cast<float>(1 / std::sqrt(square_sum / (size * size)));
  for (float& value : full) value *= scale;

  for (int lv = 0; lv < levels; ++lv)
    for (int lu = 0; lu < levels; ++lu) {
      if (lu == 0 && lv == 0) continue;
      const int columns = size >> lu, rows = size >> lv;
      auto& map = maps_[lv][lu];
      map.resize(columns * rows);
      for (int y = 0; y < rows; ++y)
        for (int x = 0; x < columns; ++x)
          map[y * columns + x] =
              lu > 0
                  ? 0.5f * (maps_[lv][lu - 1][y * 2 * columns + 2 * x] + maps_[lv][lu - 1][y * 2 * columns + 2 * x + 1])
                  : 0.5f * (maps_[lv - 1][0][2 * y * columns + x] + maps_[lv - 1][0][(2 * y + 1) * columns + x]);
    }
}

float NoiseTexture::at(float u, float v, float du, float dv) const {
  const int lu = level_of(du * (1 / texel_m), levels - 1), lv = level_of(dv * (1 / texel_m), levels - 1);
  const std::vector<float>& map = maps_[lv][lu];
  const int columns = size >> lu, rows = size >> lv;
  // Texel i of level l covers [i, i + 1) * 2^l.
  const float x = u * (1 / texel_m) / static_cast<float>(1 << lu) - 0.5f;
  const float y = v * (1 / texel_m) / static_cast<float>(1 << lv) - 0.5f;
  const float x0 = std::floor(x), y0 = std::floor(y);
  const int i = static_cast<int>(x0) & (columns - 1), j = static_cast<int>(y0) & (rows - 1);
  const int i1 = (i + 1) & (columns - 1), j1 = (j + 1) & (rows - 1);
  return blend(blend(map[j * columns + i], map[j * columns + i1], x - x0),
               blend(map[j1 * columns + i], map[j1 * columns + i1], x - x0), y - y0);
}

float albedo(const NoiseTexture& noise, Surface surface, float u, float v, float du, float dv) {
  // Every surface has its own place in the noise; a second look at another scale hides the repetition.
  const float shift_u = trait(surface, 101, 0, NoiseTexture::period_m),
              shift_v = trait(surface, 102, 0, NoiseTexture::period_m);
  const float n = 0.8f * noise.at(u + shift_u, v + shift_v, du, dv) +
                  0.6f * noise.at(0.29f * u + shift_v, 0.29f * v + shift_u, 0.29f * du, 0.29f * dv);
  const auto rough = [&](float mean, float contrast) { return std::clamp(mean * (1 + contrast * n), 0.01f, 1.f); };
  switch (surface.material) {
    case Material::road:
      return std::clamp(road_albedo(u, v, du, dv, rough(0.22f, 0.28f)), 0.01f, 1.f);
    case Material::asphalt:
      return rough(0.2f, 0.3f);
    case Material::paving:
      return paving_albedo(u, v, du, dv, rough(0.42f, 0.25f));
    case Material::kerb:
      return rough(0.55f, 0.2f);
    case Material::earth:
      return rough(0.25f, 0.4f);
    case Material::facade:
      return std::clamp(facade_albedo(surface, u, v, du, dv, rough(trait(surface, 0, 0.25f, 0.7f), 0.2f)), 0.01f, 1.f);
    case Material::roof:
      return rough(trait(surface, 0, 0.15f, 0.35f), 0.3f);
    case Material::plain:
      return rough(trait(surface, 0, 0.2f, 0.75f), 0.22f);
    case Material::metal:
      return rough(0.35f, 0.25f);
    case Material::paint:
      return rough(trait(surface, 0, 0.06f, 0.8f), 0.18f);
    case Material::glass:
      return rough(0.08f, 0.5f);
    case Material::rubber:
      return rough(0.08f, 0.5f);
    case Material::bark:
      return rough(0.2f, 0.4f);
    case Material::leaves:
      return rough(trait(surface, 0, 0.16f, 0.3f), 0.55f);
    case Material::sign:
      return sign_albedo(surface, u, v, du, dv) * (1 + 0.08f * n);
    case Material::cloth:
      return rough(trait(surface, 0, 0.08f, 0.7f), 0.3f);
    case Material::shadow:
      return rough(0.12f, 0.45f);
    case Material::ground:
      return rough(trait(surface, 0, 0.08f, 0.5f), 0.45f * trait(surface, 1, 0, 1) * trait(surface, 2, 0.1f, 1));
    case Material::foliage:
      return rough(trait(surface, 0, 0.05f, 0.4f), trait(surface, 1, 0.3f, 0.9f));
    case Material::pattern:
      return std::clamp(pattern_albedo(surface, u, v, du, dv) * (1 + 0.2f * n), 0.01f, 1.f);
    case Material::marking:
      return rough(trait(surface, 0, 0.6f, 0.95f), 0.08f);
  }
  return 0;
}

}  // namespace calib::vehicle
