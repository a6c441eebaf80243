#include "vehicle/roadside.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include "vehicle/furniture.hpp"
#include "vehicle/houses.hpp"
#include "vehicle/vegetation.hpp"

namespace calib::vehicle {
namespace {

using Eigen::Isometry3f;
using Eigen::Translation3f;
using Eigen::Vector3f;

constexpr float behind_m = 40, ahead_m = 320, land_m = 260, half_turn = 3.14159265f;

Surface surface_of(Material material, Random& random) { return {material, static_cast<std::uint32_t>(random.bits())}; }

/// Fewer leaves on what is far away, where the difference does not show.
int cards_at(float x, int near) {
  return std::clamp(static_cast<int>(static_cast<float>(near) * 12 / std::max(x, 12.f)), 12, near);
}

}  // namespace

Roadside::Roadside(std::uint64_t key) : random_(key) {
  lane_ = random_.uniform(2.7f, 3.9f);
  half_width_ = lane_ * static_cast<float>(1 + random_.below(3)) * (random_.chance(0.3f) ? 0.8f : 1.f);
  bend_ = random_.chance(0.4f) ? 0 : random_.uniform(-1, 1) * random_.uniform(0, 0.006f);
  sway_ = random_.uniform(0, 4), sway_phase_ = random_.uniform(0, 6.28f);
  hill_ = random_.uniform(0, 2.5f) * random_.uniform(0, 1), hill_phase_ = random_.uniform(0, 6.28f);
  if (random_.chance(0.35f)) crossing_ = random_.uniform(8, 70), crossing_width_ = random_.uniform(7, 25);
  const float green = random_.uniform(0, 1);
  for (Side* side : {&left_, &right_}) {
    side->verge = random_.uniform(0.5f, 8);
    side->kerb = random_.chance(0.6f) ? random_.uniform(0.05f, 0.18f) : 0;
    side->slope = random_.chance(0.5f) ? 0 : random_.uniform(-0.12f, 0.6f);
    side->plateau = side->verge + random_.uniform(2, 14);
    side->verge_surface = surface_of(random_.chance(0.3f) ? Material::paving : Material::ground, random_);
    side->land = surface_of(Material::ground, random_);
    side->green = std::clamp(green + random_.uniform(-0.3f, 0.3f), 0.f, 1.f);
  }
}

float Roadside::ground(float x, float d) const {
  const float out = std::abs(d) - half_width_;
  if (out <= 0 || in_crossing(x)) return 0;
  const Side& side = d > 0 ? left_ : right_;
  return side.kerb + side.slope * std::clamp(out - side.verge, 0.f, side.plateau - side.verge);
}

Isometry3f Roadside::pose(float x, float d, float height, float heading) const {
  const auto y = [&](float at) {
    return 0.5f * bend_ * at * at + sway_ * (std::sin(at / 37 + sway_phase_) - std::sin(sway_phase_));
  };
  const float z = hill_ * (std::sin(x / 45 + hill_phase_) - std::sin(hill_phase_));
  Isometry3f result = Isometry3f::Identity();
  result.translation() << x, y(x) + d, z + ground(x, d) + height;
  result.rotate(Eigen::AngleAxisf(heading + std::atan(y(x + 0.5f) - y(x - 0.5f)), Vector3f::UnitZ()));
  return result;
}

bool Roadside::is_free(float x, float d, float reach) const {
  return x > 3.5f + reach || x < -1 - reach || std::abs(d - own_d_) > 1.4f + reach;
}

void Roadside::fill(float d) {
  own_d_ = d;
  add_ground();
  add_markings();
  add_patches();
  add_side(left_, 1);
  add_side(right_, -1);
  add_traffic();
  add_loose_things();
}

void Roadside::add_ground() {
  const Surface road = surface_of(Material::ground, random_), pavement = surface_of(Material::kerb, random_);
  struct Strip {
    float from, to;  // d
    Surface surface;
  };
  std::vector<Strip> strips{{0, half_width_, road}, {-half_width_, 0, road}};
  for (const float sign : {1.f, -1.f}) {
    const Side& side = sign > 0 ? left_ : right_;
    const float edge = half_width_ + 0.01f;  // a kerb is the strip that rises
    const std::array<float, 5> out{half_width_, edge, edge + side.verge, half_width_ + side.plateau, land_m};
    const std::array<Surface, 4> surface{pavement, side.verge_surface, side.land, side.land};
    for (int i = 0; i < 4; ++i) {
      const float a = sign * out[i], b = sign * out[i + 1];
      strips.push_back({std::min(a, b), std::max(a, b), surface[i]});
    }
  }
  float step = 3;
  for (float x = -behind_m; x < ahead_m; x += step) {
    if (x > 100) step = 12;
    const float end = x + step;
    const bool flat = in_crossing(x) && in_crossing(end);
    const auto corner = [&](float at, float d) {
      // Where a crossing ends, the height is that of just before.
      const float along = at == x && in_crossing(x) && !flat ? x - 0.01f : at;
      Vector3f p = pose(at, d, 0, 0).translation();
      p.z() = pose(along, d, 0, 0).translation().z();
      return Corner{p, at, d};
    };
    for (const auto& [from, to, surface] : strips)
      mesh_.add_quad({corner(x, from), corner(end, from), corner(end, to), corner(x, to)}, flat ? road : surface);
  }
}

/// Lines along the road, and stripes across it.
void Roadside::add_markings() {
  if (random_.chance(0.15f)) return;
  const Surface paint = surface_of(Material::marking, random_);
  const auto stripe = [&](float from, float to, float d0, float d1) {
    for (float x = from; x < to; x += 3) {
      const float end = std::min(x + 3, to);
      const auto at = [&](float along, float d) -> Vector3f { return pose(along, d, 0.01f, 0).translation(); };
      mesh_.add_quad(at(x, d0), at(end, d0), at(end, d1), at(x, d1), paint);
    }
  };
  const float width = random_.uniform(0.08f, 0.22f);
  for (float d = -half_width_ + 0.3f; d < half_width_; d += lane_ * random_.uniform(0.9f, 1.1f)) {
    const int kind = random_.below(4);
    if (kind == 0) stripe(-behind_m, 150, d, d + width);
    if (kind > 1) {
      const float length = random_.uniform(1, 5), gap = random_.uniform(1, 7);
      for (float x = -5; x < 150; x += length + gap) stripe(x, x + length, d, d + width);
    }
  }
  if (!random_.chance(0.3f)) return;
  const float x = random_.uniform(4, 50), length = random_.uniform(0.4f, 4), pitch = random_.uniform(0.6f, 1.5f);
  for (float d = -half_width_; d < half_width_ - pitch; d += pitch)
    stripe(x, x + length, d, d + (length < 1 ? pitch : 0.5f * pitch));
}

/// Repairs, dirt and stains: flat, whatever they look like.
void Roadside::add_patches() {
  for (int i = random_.below(14); i > 0; --i) {
    const float x = random_.uniform(1, 50), d = random_.uniform(-1.5f, 1.5f) * half_width_;
    const float length = random_.uniform(0.5f, 10), width = random_.uniform(0.3f, 4), skew = random_.uniform(-2, 2);
    const int kind = random_.below(6);
    const Surface surface = surface_of(kind == 0   ? Material::pattern
                                       : kind == 1 ? Material::marking
                                       : kind == 2 ? Material::shadow
                                                   : Material::ground,
                                       random_);
    const auto at = [&](float along, float across) -> Vector3f {
      return pose(along, across, 0.006f + 0.0003f * static_cast<float>(i), 0).translation();
    };
    if (std::abs(d) < half_width_ && std::abs(d + width + skew) < half_width_)
      mesh_.add_quad(at(x, d), at(x + length, d + skew), at(x + length, d + width + skew), at(x, d + width), surface);
  }
}

void Roadside::add_side(const Side& side, float sign) {
  for (float x = -30; x < 260;) {
    const float length = random_.uniform(12, 90);
    add_segment(side, sign, x, std::min(x + length, 280.f));
    x += length;
  }
  // What stands along the road.
  const float spacing = random_.uniform(4, 40), tree_share = side.green * random_.uniform(0, 1);
  for (float x = -10; x < 150; x += spacing * random_.uniform(0.4f, 1.6f)) {
    const float d = sign * (half_width_ + random_.uniform(0.3f, std::max(0.6f, side.verge)));
    if (in_crossing(x) || !is_free(x, d, 0.5f)) continue;
    const Isometry3f place = pose(x, d, 0, sign > 0 ? 0 : half_turn);
    if (random_.chance(tree_share)) {
      add_ragged_tree(mesh_, place, random_.uniform(2.5f, 14), cards_at(x, 280), random_);
      continue;
    }
    switch (random_.below(7)) {
      case 0:
      case 1:
        mesh_.add_tube(place, random_.uniform(0.04f, 0.2f), 0.05f, random_.uniform(2, 10), 7, any_surface());
        break;
      case 2:
        add_lamp_post(mesh_, place, random_);
        break;
      case 3:
        add_traffic_sign(mesh_, place, random_);
        break;
      case 4:
        add_person(mesh_, place, random_);
        break;
      case 5:
        add_box_furniture(mesh_, place, random_);
        break;
      default:
        add_bollards(mesh_, place, random_);
    }
  }
  if (random_.chance(0.3f)) add_row(sign, half_width_ - 1, random_.uniform(-5, 20), random_.uniform(20, 120), 6, 0);
}

/// A row of parked cars.
void Roadside::add_row(float sign, float d, float from, float to, float gap, float heading) {
  for (float x = from; x < to; x += gap * random_.uniform(0.9f, 1.5f)) {
    if (in_crossing(x) || !is_free(x, sign * d, 2.3f) || random_.chance(0.25f)) continue;
    const float turn = heading + (random_.chance(0.5f) ? half_turn : 0) + random_.uniform(-0.05f, 0.05f);
    add_car(mesh_, pose(x, sign * d, 0, turn), random_);
  }
}

void Roadside::add_segment(const Side& side, float sign, float from, float to) {
  const float begin = half_width_ + side.verge;
  const auto along = [&](float step, auto&& add) {
    for (float x = from; x < to; x += step * random_.uniform(0.6f, 1.4f))
      if (!in_crossing(x)) add(x);
  };
  const int kind = random_.chance(side.green) ? random_.below(5) : 5 + random_.below(5);
  switch (kind) {
    case 0:
    case 1: {  // a wood, or its edge
      const float depth = random_.uniform(3, 22), tall = random_.uniform(5, 16), step = random_.uniform(2.5f, 5);
      const bool undergrowth = random_.chance(0.7f);
      for (float out = begin; out < begin + depth; out += step)
        along(step * 1.3f, [&](float x) {
          const float d = sign * (out + random_.uniform(0, step)), z = random_.uniform(0.3f, 1.8f);
          if (!is_free(x, d, 2)) return;
          const int cards = cards_at(x + 3 * (out - begin), 180);
          add_ragged_tree(mesh_, pose(x, d, 0, 0), tall * random_.uniform(0.6f, 1.2f), cards, random_);
          if (undergrowth)
            add_bush(mesh_, pose(x, d - sign * 1.5f, 0.6f * z, 0).translation(), {1.8f, 1.5f, z}, cards / 2, random_);
        });
      break;
    }
    case 2: {  // a hedge
      const float height = random_.uniform(0.6f, 3), out = begin + random_.uniform(0, 4);
      along(1.8f, [&](float x) {
        if (is_free(x, sign * out, 1.3f))
          add_bush(mesh_, pose(x, sign * out, 0.45f * height, 0).translation(), {1.5f, 0.8f, 0.6f * height},
                   cards_at(x, 110), random_);
      });
      break;
    }
    case 3:  // a field: a bush here and there, and high grass by the road
      along(25, [&](float x) {
        const float d = sign * (begin + random_.uniform(2, 60)), size = random_.uniform(0.5f, 2.5f);
        add_bush(mesh_, pose(x, d, 0.6f * size, 0).translation(), {size, size, size}, 40, random_);
      });
      along(2, [&](float x) {
        if (x > -2 && x < 40) add_tall_grass(mesh_, pose(x, sign * begin, 0, 0).translation(), 1.5f, 14, random_);
      });
      break;
    case 4: {  // trees in a line
      const float tall = random_.uniform(4, 14), out = begin + random_.uniform(0, 5);
      along(random_.uniform(5, 11), [&](float x) {
        if (is_free(x, sign * out, 1))
          add_ragged_tree(mesh_, pose(x, sign * out, 0, 0), tall * random_.uniform(0.8f, 1.2f), cards_at(x, 280),
                          random_);
      });
      break;
    }
    case 5:
    case 6:
    case 7: {  // houses
      const float back = begin + random_.uniform(0, 12);
      for (float x = from; x < to;) {
        const float width = random_.uniform(7, 24);
        const Isometry3f place = sign > 0 ? pose(x, back, 0, 0) : pose(x + width, -back, 0, half_turn);
        if (!in_crossing(x) && !in_crossing(x + width) && back - half_width_ > 1)
          add_house(mesh_, place, width, random_);
        x += width + (random_.chance(0.5f) ? 0 : random_.uniform(1, 10));
      }
      break;
    }
    case 8: {  // a wall, a fence or a guard rail
      const float low = random_.chance(0.4f) ? random_.uniform(0.3f, 0.6f) : 0,
                  high = low + random_.uniform(0.3f, 2.2f);
      const Surface surface = any_surface(), post = surface_of(Material::metal, random_);
      for (float x = from; x < to; x += 3) {
        if (in_crossing(x) || in_crossing(x + 3)) continue;
        const Isometry3f place = pose(x, sign * begin, 0, 0);
        mesh_.add_box(place, {0, -0.08f, low}, {3.05f, 0.08f, high}, surface);
        mesh_.add_box(place, {0, -0.12f, 0}, {0.12f, 0.12f, high}, post);
      }
      break;
    }
    default:  // parked cars, nose to the road
      add_row(sign, begin + 2.5f, from, to, 2.8f, 0.5f * half_turn);
  }
}

void Roadside::add_traffic() {
  const float gap = random_.uniform(10, 90);
  for (float d = 0.5f * lane_ - half_width_; d < half_width_; d += lane_)
    for (float x = random_.uniform(-20, 25); x < 180; x += 6 + gap * random_.uniform(0.3f, 1.7f))
      if (is_free(x, d, 3))
        add_car(mesh_, pose(x, d + random_.uniform(-0.4f, 0.4f), 0, d > 0 ? half_turn : 0), random_);
  if (crossing_ < 200)
    for (float d = random_.uniform(-60, -10); d < 60; d += random_.uniform(6, 40)) {
      const float x = crossing_ + crossing_width_ * random_.uniform(0.2f, 0.8f);
      if (is_free(x, d, 3))
        add_car(mesh_, pose(x, d, 0, (random_.chance(0.5f) ? 0.5f : -0.5f) * half_turn + random_.uniform(-0.3f, 0.3f)),
                random_);
    }
}

Surface Roadside::any_surface() {
  constexpr std::array<Material, 8> materials{Material::plain, Material::paint,   Material::metal, Material::cloth,
                                              Material::sign,  Material::pattern, Material::bark,  Material::facade};
  return surface_of(materials[random_.below(8)], random_);
}

/// Things of every shape and size in every place, some in the air: the kind of a thing is independent of its distance.
void Roadside::add_loose_things() {
  for (int i = random_.chance(0.5f) ? 0 : random_.below(9); i > 0; --i) {
    const float x = random_.uniform(3, 45), d = random_.uniform(-0.3f, 0.3f) * x + random_.uniform(-6, 6);
    const float size = std::exp(random_.uniform(-1.2f, 1.2f));
    if (!is_free(x, d, size)) continue;
    const float height = random_.chance(0.75f) ? 0 : random_.uniform(0.3f, 5);
    const Isometry3f place = pose(x, d, height, random_.uniform(0, 6.28f));
    const Vector3f half =
        0.5f * size * Vector3f(random_.uniform(0.3f, 2), random_.uniform(0.3f, 2), random_.uniform(0.6f, 4));
    switch (random_.below(4)) {
      case 0:
        mesh_.add_tube(place, half.x(), half.x() * random_.uniform(0.5f, 1), 2 * half.z(), 9, any_surface());
        break;
      case 1:
        add_bush(mesh_, place * Vector3f(0, 0, half.z()), half, 50, random_);
        break;
      default:
        mesh_.add_box(place, {-half.x(), -half.y(), 0}, {half.x(), half.y(), 2 * half.z()}, any_surface());
    }
  }
  if (random_.chance(0.06f)) {  // a bridge
    const float x = random_.uniform(15, 80), z = random_.uniform(4, 6.5f), width = random_.uniform(3, 12);
    mesh_.add_box(pose(x, 0, z, random_.uniform(-0.3f, 0.3f)), {0, -60, 0}, {width, 60, random_.uniform(0.6f, 2.5f)},
                  any_surface());
  }
  // Hills, or a line of woods, at the end of the view.
  if (random_.chance(0.6f)) {
    const Surface woods = surface_of(Material::foliage, random_);
    const float tall = random_.uniform(6, 40);
    for (float d = -240; d < 240; d += 14)
      mesh_.add_blob(pose(240 + random_.uniform(-10, 30), d, 0, 0).translation(),
                     {12, 14, tall * random_.uniform(0.5f, 1)}, 0.3f, random_.bits(), woods);
  }
}

}  // namespace calib::vehicle
