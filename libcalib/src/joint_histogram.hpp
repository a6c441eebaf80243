#pragma once

#include <hwy/cache_control.h>

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>

#include "calib/features.hpp"

namespace calib {

/// Points that are projected together.
struct PointBlock {
  static constexpr std::size_t capacity = 1024, most_features = 3;
  const std::int16_t *x, *y, *z;
  /// Ranks of the points' features that are wanted, at least of one; then null.
  std::array<const std::uint8_t*, most_features> ranks;
  std::size_t count;
};

/// The points of a block that are in view.
struct ProjectedPoints {
  static constexpr std::size_t slack = 64;  // whole vectors are written
  std::size_t count = 0;
  alignas(64) std::array<std::int32_t, PointBlock::capacity + slack> pixel{};
  /// A byte for each of the block's features, and one for the tile of the image.
  alignas(64) std::array<std::int32_t, PointBlock::capacity + slack> ranks{};
  static constexpr int tile_shift = 8 * PointBlock::most_features;
  /// Of the plane that was looked up last.
  alignas(64) std::array<std::uint16_t, PointBlock::capacity + slack> value{};
};

/// Joint counts: rows are classes of the points' feature, columns of the pixels'. The last column takes the points that
/// project to a pixel without a value. With tiles there is one such table per tile, one after the other.
struct CountsShape {
  int rank_shift;   // where the point's rank begins in `ProjectedPoints::ranks`
  int class_shift;  // its class is rank >> class_shift
  int value_shift;  // a pixel's is value >> value_shift, less the bits that are not of it
  int value_mask;
  int row_shift;    // log2 of a row's length
  int table_shift;  // log2 of a table's length
};

/// The projection of a frame's points, with the grid's intrinsics.
struct Projection {
  std::array<float, 12> T_camera_points;  // to m from the points' unit, row-major 3 x 4
  BearingGrid grid;
};

namespace simd {

/// For each set of up to eight lanes, which of them it has, in order; then any.
inline constexpr auto lanes_of_set = [] {
  std::array<std::array<std::uint8_t, 8>, 256> lanes{};
  for (unsigned set = 0; set < lanes.size(); ++set)
    for (std::uint8_t lane = 0, found = 0; lane < 8; ++lane)
      if ((set >> lane & 1) != 0) lanes[set][found++] = lane;
  return lanes;
}();

/// x log x of a small count; most counts of a joint histogram are.
extern const std::array<double, 4096> x_log_x;

/// Sums of x log x over a table's counts, over the sums of its rows and over those of its columns; and all its counts.
struct TableSums {
  static constexpr std::size_t longest_row = 256, slack = 32;  // whole vectors are read
  double joint = 0, rows = 0, columns = 0;
  std::uint32_t points = 0;
};

void project(const PointBlock& block, const Projection& projection, bool with_tiles, ProjectedPoints& projected);

/// Reads the values of the pixels that the points project to.
template <typename Value>
void look_up(const Value* plane, ProjectedPoints& projected) {
  constexpr std::size_t ahead = 48;  // a plane exceeds the nearest caches, and the order of reading has no pattern
  const std::size_t count = projected.count;
  std::size_t i = 0;
  for (; i + ahead < count; ++i) {
    hwy::Prefetch(plane + projected.pixel[i + ahead]);
    projected.value[i] = plane[projected.pixel[i]];
  }
  for (; i < count; ++i) projected.value[i] = plane[projected.pixel[i]];
}

/// Adds the points that were looked up to `counts`.
void count(const ProjectedPoints& projected, const CountsShape& shape, bool tiled, std::uint32_t* counts);

/// Of a table of `classes` rows and columns, `length` counts from row to row. Smoothed with [1 2 1] in both directions
/// (beyond the edge is what is at the edge) when wanted, so that a point counts sixteen times. `TableSums::slack` more
/// counts must be readable behind the table.
TableSums sums_of_table(const std::uint32_t* counts, std::size_t classes, std::size_t length, bool smoothed);

const char* target_name();

}  // namespace simd
}  // namespace calib
