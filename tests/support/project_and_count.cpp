#include <hwy/targets.h>

#include <bit>
#include <cstdint>
#include <cstdio>
#include <vector>

#include "joint_histogram.hpp"

// Prints what the vector code makes of made-up points, for each set of instructions: which pixels they project to, the
// joint counts, and the sums over them. Built for other processors too, and compared.

namespace {

/// The same numbers everywhere, which those of <random> are not.
class Numbers {
 public:
  std::uint32_t next() {
    state_ = state_ * 6364136223846793005U + 1442695040888963407U;
    return static_cast<std::uint32_t>(state_ >> 33);
  }
  int within(int least, int most) { return least + static_cast<int>(next() % static_cast<unsigned>(most - least + 1)); }

 private:
  std::uint64_t state_ = 12345;
};

void print(const calib::BearingGrid& grid, bool with_tiles) {
  using namespace calib;
  Numbers numbers;
  constexpr std::size_t points = 997;  // no multiple of any vector's length
  std::vector<std::int16_t> x, y, z;
  std::vector<std::uint8_t> range, reflectance;
  for (std::size_t i = 0; i < points; ++i) {
    x.push_back(static_cast<std::int16_t>(numbers.within(-20000, 20000)));
    y.push_back(static_cast<std::int16_t>(numbers.within(-20000, 20000)));
    z.push_back(static_cast<std::int16_t>(numbers.within(-5000, 5000)));
    range.push_back(static_cast<std::uint8_t>(numbers.within(0, 239)));
    reflectance.push_back(static_cast<std::uint8_t>(numbers.within(0, 239)));
  }
  std::vector<std::uint16_t> plane(grid.pixels());
  for (std::uint16_t& pixel : plane) pixel = static_cast<std::uint16_t>(numbers.next());
  // x forward to z forward, and a little turned.
  constexpr float unit = 1 / 256.F;
  const Projection projection{{0.01F * unit, -0.99F * unit, 0.02F * unit, 0.1F,     //
                               -0.02F * unit, 0.01F * unit, -0.98F * unit, -0.07F,  //
                               0.99F * unit, 0.02F * unit, -0.01F * unit, -0.3F},
                              grid};
  ProjectedPoints projected;
  simd::project({x.data(), y.data(), z.data(), {range.data(), reflectance.data(), nullptr}, points}, projection,
                with_tiles, projected);
  simd::look_up(plane.data(), projected);
  std::printf("%s: %zu in view", with_tiles ? "tiled" : "whole", projected.count);
  std::uint64_t digest = 0;
  for (std::size_t i = 0; i < projected.count; ++i)
    digest = (digest * 31 + static_cast<std::uint32_t>(projected.pixel[i])) * 31 +
             static_cast<std::uint32_t>(projected.ranks[i]);
  const CountsShape shape{
      .rank_shift = 8, .class_shift = 3, .value_shift = 6, .value_mask = 31, .row_shift = 5, .table_shift = 10};
  std::vector<std::uint32_t> counts(FeatureSet::tile_columns * FeatureSet::tile_rows * 1024 + simd::TableSums::slack);
  simd::count(projected, shape, with_tiles, counts.data());
  for (const std::uint32_t count : counts) digest = digest * 31 + count;
  std::printf(", digest %016llx", static_cast<unsigned long long>(digest));
  for (const bool smoothed : {false, true}) {
    const simd::TableSums sums = simd::sums_of_table(counts.data(), 30, 32, smoothed);
    std::printf(", %u points %.10e %.10e %.10e", sums.points, sums.joint, sums.rows, sums.columns);
  }
  std::printf("\n");
}

void print_all() {
  std::printf("%s\n", calib::simd::target_name());
  for (const bool with_tiles : {false, true}) {
    print({.width = 1242, .height = 375, .fx = 721, .fy = 722, .cx = 610, .cy = 173, .xi = 0}, with_tiles);
    print({.width = 777, .height = 601, .fx = 190, .fy = 190, .cx = 388, .cy = 300, .xi = 1}, with_tiles);
  }
}

}  // namespace

int main() {
#ifdef HWY_COMPILE_ONLY_STATIC
  print_all();
#else
  for (const std::int64_t target : hwy::SupportedAndGeneratedTargets()) {
    hwy::SetSupportedTargetsForTest(target);
    print_all();
  }
#endif
}
