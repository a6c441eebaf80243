#include "joint_histogram.hpp"

#include <algorithm>
#include <cmath>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "joint_histogram.cpp"
#include <hwy/foreach_target.h>
// After it, for each target anew.
#include <hwy/contrib/math/math-inl.h>
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace calib::simd {
namespace HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;
using Floats = hn::ScalableTag<float>;
using Ints = hn::RebindToSigned<Floats>;
using Doubles = hn::CappedTag<double, 8>;  // no longer than a table's rows
using Counts = hn::CappedTag<std::uint32_t, 16>;

/// Moves those lanes to the front that are in a set.
class LanesInFront {
 public:
#if HWY_HAVE_SCALABLE || HWY_TARGET <= HWY_AVX3
  explicit HWY_INLINE LanesInFront(hn::Mask<Ints> set) : set_(set) {}
  // Not CompressStore: some processors are very slow at it.
  HWY_INLINE hn::Vec<Ints> operator()(hn::Vec<Ints> values) const { return hn::Compress(values, set_); }

 private:
  hn::Mask<Ints> set_;
#else
  // Without an instruction for it, Compress of Highway 1.0 copies a table to the stack at each call.
  explicit HWY_INLINE LanesInFront(hn::Mask<Ints> set) : order_(order_of(set)) {}
  HWY_INLINE hn::Vec<Ints> operator()(hn::Vec<Ints> values) const { return hn::TableLookupLanes(values, order_); }

 private:
  using Order = decltype(hn::IndicesFromVec(Ints(), hn::Zero(Ints())));
  static HWY_INLINE Order order_of(hn::Mask<Ints> set) {
    std::uint8_t bits[8] = {};
    hn::StoreMaskBits(Ints(), set, bits);
    const hn::Rebind<std::uint8_t, Ints> bytes;
    return hn::IndicesFromVec(Ints(), hn::PromoteTo(Ints(), hn::LoadU(bytes, lanes_of_set[bits[0]].data())));
  }
  Order order_;
#endif
};

/// Adding it leaves the nearest integer of a float of at most 2^22 in the lowest bits, less its own.
constexpr float rounding = 12582912.F;

template <bool wide, bool tiled>
HWY_INLINE void project_block(const PointBlock& block, const Projection& projection, ProjectedPoints& projected) {
  constexpr std::size_t most_lanes = HWY_MAX_BYTES / sizeof(float);
  static_assert(most_lanes <= ProjectedPoints::slack);
  const Floats f;
  const Ints ints;
  const hn::RebindToUnsigned<Ints> bits;
  const hn::Rebind<std::uint8_t, Ints> bytes;
  const hn::Rebind<std::int16_t, Ints> shorts;
  // Copies: else they were read again for each vector, because what is stored could have changed them.
  const auto& T = projection.T_camera_points;
  const BearingGrid& grid = projection.grid;
  // A pinhole's focal lengths go into the rows of the transform.
  const float x_unit = wide ? 1 : grid.fx, y_unit = wide ? 1 : grid.fy;
  const auto t0 = hn::Set(f, x_unit * T[0]), t1 = hn::Set(f, x_unit * T[1]), t2 = hn::Set(f, x_unit * T[2]);
  const auto t3 = hn::Set(f, x_unit * T[3]), t4 = hn::Set(f, y_unit * T[4]), t5 = hn::Set(f, y_unit * T[5]);
  const auto t6 = hn::Set(f, y_unit * T[6]), t7 = hn::Set(f, y_unit * T[7]);
  const auto t8 = hn::Set(f, T[8]), t9 = hn::Set(f, T[9]), t10 = hn::Set(f, T[10]), t11 = hn::Set(f, T[11]);
  const auto fx = hn::Set(f, grid.fx), fy = hn::Set(f, grid.fy), cx = hn::Set(f, grid.cx), cy = hn::Set(f, grid.cy);
  const auto right = hn::Set(f, static_cast<float>(grid.width) - 0.5F);
  const auto bottom = hn::Set(f, static_cast<float>(grid.height) - 0.5F), least = hn::Set(f, -0.5F);
  const auto one = hn::Set(f, 1), xi = hn::Set(f, grid.xi), nearest = hn::Set(f, 1e-6F);
  const auto round = hn::Set(f, rounding);
  const auto row_length = hn::Set(bits, static_cast<std::uint32_t>(grid.width));
  const auto bits_of_rounding = hn::BitCast(bits, round);
  const auto first_pixel = hn::Add(hn::Mul(bits_of_rounding, row_length), bits_of_rounding);
  // A pixel's tile is that of its middle. A middle on the line between two tiles is in the further one, and a 64th of a
  // pixel keeps it there.
  const float across = static_cast<float>(FeatureSet::tile_columns) / static_cast<float>(grid.width);
  const float down = static_cast<float>(FeatureSet::tile_rows) / static_cast<float>(grid.height);
  const auto tiles_across = hn::Set(f, across), tiles_down = hn::Set(f, down);
  const auto first_across = hn::Set(f, across * (0.5F + 1.F / 64) - 0.5F);
  const auto first_down = hn::Set(f, down * (0.5F + 1.F / 64) - 0.5F);
  const auto tile_columns = hn::Set(f, static_cast<float>(FeatureSet::tile_columns));
  std::int32_t *const pixels = projected.pixel.data(), *const ranks = projected.ranks.data();
  std::size_t seen_before = 0;

  const auto project_vector = [&](const PointBlock& from, std::size_t i, auto known) HWY_ATTR {
    const auto load = [&](const std::int16_t* values)
                          HWY_ATTR { return hn::ConvertTo(f, hn::PromoteTo(ints, hn::LoadU(shorts, values + i))); };
    const auto x = load(from.x), y = load(from.y), z = load(from.z);
    const auto x_camera = hn::MulAdd(t0, x, hn::MulAdd(t1, y, hn::MulAdd(t2, z, t3)));
    const auto y_camera = hn::MulAdd(t4, x, hn::MulAdd(t5, y, hn::MulAdd(t6, z, t7)));
    const auto z_camera = hn::MulAdd(t8, x, hn::MulAdd(t9, y, hn::MulAdd(t10, z, t11)));
    auto u = x_camera, v = y_camera, denominator = z_camera;
    if constexpr (wide) {
      const auto squared = hn::MulAdd(x_camera, x_camera, hn::MulAdd(y_camera, y_camera, hn::Mul(z_camera, z_camera)));
      denominator = hn::MulAdd(xi, hn::Sqrt(squared), z_camera);
      u = hn::Mul(fx, x_camera);
      v = hn::Mul(fy, y_camera);
    }
    const auto inverse = hn::Div(one, denominator);
    u = hn::MulAdd(u, inverse, cx);
    v = hn::MulAdd(v, inverse, cy);
    // Comparisons with NaN are false, so that what is not a number is not in view.
    const auto in_view = hn::And(hn::And(hn::Gt(denominator, nearest), hn::And(hn::Ge(u, least), hn::Lt(u, right))),
                                 hn::And(hn::Ge(v, least), hn::Lt(v, bottom)));
    const auto seen = known(hn::RebindMask(ints, in_view));
    if (hn::AllFalse(ints, seen)) return;  // often: neighbours follow each other
    const LanesInFront seen_first(seen);
    const auto column = hn::Add(u, round), line = hn::Add(v, round);
    const auto pixel = hn::Add(hn::Mul(hn::BitCast(bits, line), row_length), hn::BitCast(bits, column));
    hn::StoreU(seen_first(hn::BitCast(ints, hn::Sub(pixel, first_pixel))), ints, pixels + seen_before);
    auto packed = hn::PromoteTo(ints, hn::LoadU(bytes, from.ranks[0] + i));
    if (from.ranks[1] != nullptr)
      packed = hn::Or(packed, hn::ShiftLeft<8>(hn::PromoteTo(ints, hn::LoadU(bytes, from.ranks[1] + i))));
    if (from.ranks[2] != nullptr)
      packed = hn::Or(packed, hn::ShiftLeft<16>(hn::PromoteTo(ints, hn::LoadU(bytes, from.ranks[2] + i))));
    if constexpr (tiled) {
      const auto tile_across = hn::Add(hn::MulAdd(hn::Sub(column, round), tiles_across, first_across), round);
      const auto tile_down = hn::Add(hn::MulAdd(hn::Sub(line, round), tiles_down, first_down), round);
      const auto tile = hn::MulAdd(hn::Sub(tile_down, round), tile_columns, tile_across);
      packed = hn::Or(packed, hn::ShiftLeft<ProjectedPoints::tile_shift>(hn::BitCast(ints, tile)));
    }
    hn::StoreU(seen_first(packed), ints, ranks + seen_before);
    seen_before += hn::CountTrue(ints, seen);
  };

  const std::size_t lanes = hn::Lanes(f);
  std::size_t i = 0;
  for (; i + lanes <= block.count; i += lanes) project_vector(block, i, [](auto mask) HWY_ATTR { return mask; });
  if (const std::size_t left = block.count - i; left > 0) {
    std::int16_t coordinates[3][most_lanes] = {};
    std::uint8_t rest_ranks[PointBlock::most_features][most_lanes] = {};
    PointBlock rest{coordinates[0], coordinates[1], coordinates[2], {}, left};
    std::copy_n(block.x + i, left, coordinates[0]);
    std::copy_n(block.y + i, left, coordinates[1]);
    std::copy_n(block.z + i, left, coordinates[2]);
    for (std::size_t k = 0; k < rest.ranks.size(); ++k)
      if (block.ranks[k] != nullptr) {
        std::copy_n(block.ranks[k] + i, left, rest_ranks[k]);
        rest.ranks[k] = rest_ranks[k];
      }
    project_vector(rest, 0, [&](auto mask) HWY_ATTR { return hn::And(mask, hn::FirstN(ints, left)); });
  }
  projected.count = seen_before;
}

void Project(const PointBlock& block, const Projection& projection, bool with_tiles, ProjectedPoints& projected) {
  const bool wide = projection.grid.xi != 0;
  if (wide && with_tiles) return project_block<true, true>(block, projection, projected);
  if (wide) return project_block<true, false>(block, projection, projected);
  if (with_tiles) return project_block<false, true>(block, projection, projected);
  project_block<false, false>(block, projection, projected);
}

void Count(const ProjectedPoints& projected, const CountsShape& shape, bool tiled, std::uint32_t* counts) {
  const Ints ints;
  const hn::Rebind<std::uint16_t, Ints> values;
  const std::size_t count = projected.count;
  const auto row_mask = hn::Set(ints, 255 >> shape.class_shift), value_mask = hn::Set(ints, shape.value_mask);
  const int rank_shift = shape.rank_shift + shape.class_shift, row_shift = shape.row_shift;
  const int value_shift = shape.value_shift, table_shift = shape.table_shift;
  alignas(64) std::int32_t cells[PointBlock::capacity + ProjectedPoints::slack];
  for (std::size_t i = 0; i < count; i += hn::Lanes(ints)) {
    const auto ranks = hn::LoadU(ints, projected.ranks.data() + i);
    const auto value = hn::PromoteTo(ints, hn::LoadU(values, projected.value.data() + i));
    auto cell = hn::ShiftLeftSame(hn::And(hn::ShiftRightSame(ranks, rank_shift), row_mask), row_shift);
    cell = hn::Or(cell, hn::And(hn::ShiftRightSame(value, value_shift), value_mask));
    if (tiled) cell = hn::Or(cell, hn::ShiftLeftSame(hn::ShiftRight<ProjectedPoints::tile_shift>(ranks), table_shift));
    hn::StoreU(cell, ints, cells + i);
  }
  // Four places of the block in turn: neighbours often fall into the same cell, and would wait for each other.
  const std::size_t quarter = count / 4;
  const std::int32_t *const first = cells, *const second = first + quarter, *const third = second + quarter,
                            *const fourth = third + quarter;
  for (std::size_t i = 0; i < quarter; ++i) {
    ++counts[first[i]];
    ++counts[second[i]];
    ++counts[third[i]];
    ++counts[fourth[i]];
  }
  for (std::size_t i = 4 * quarter; i < count; ++i) ++counts[cells[i]];
}

/// Sum of x log x, of large counts.
HWY_INLINE double sum_of_logs(const std::uint32_t* values, std::size_t count) {
  const Doubles d;
  const hn::Rebind<std::uint32_t, Doubles> counts;
  const std::size_t lanes = hn::Lanes(d);
  auto sum = hn::Zero(d);
  for (std::size_t i = 0; i < count; i += lanes) {
    const auto x = hn::PromoteTo(d, hn::BitCast(hn::RebindToSigned<decltype(counts)>(), hn::LoadU(counts, values + i)));
    sum = hn::MulAdd(x, hn::Log(d, hn::Max(x, hn::Set(d, 1))), sum);
  }
  return hn::GetLane(hn::SumOfLanes(d, sum));
}

/// Sum of x log x. `count` is a multiple of four.
HWY_INLINE double sum_x_log_x(const std::uint32_t* values, std::size_t count, std::uint32_t most) {
  if (most >= x_log_x.size()) return sum_of_logs(values, count);
  double a = 0, b = 0, c = 0, d = 0;  // four sums, because one would wait for each addition
  for (std::size_t i = 0; i < count; i += 4) {
    a += x_log_x[values[i]];
    b += x_log_x[values[i + 1]];
    c += x_log_x[values[i + 2]];
    d += x_log_x[values[i + 3]];
  }
  return (a + b) + (c + d);
}

/// Smooths the row with [1 2 1]; beyond the edge is what is at the edge. Reads up to a vector beyond the row's end.
HWY_INLINE void smooth_row(const std::uint32_t* row, std::size_t classes, std::size_t length, std::uint32_t* to) {
  const Counts c;
  for (std::size_t j = 0; j < length; j += hn::Lanes(c)) {
    const auto here = hn::LoadU(c, row + j + 1);
    hn::StoreU(hn::Add(hn::Add(hn::LoadU(c, row + j), hn::LoadU(c, row + j + 2)), hn::Add(here, here)), c, to + j + 1);
  }
  to[0] = 3 * row[0] + row[1];
  to[classes - 1] = 3 * row[classes - 1] + row[classes - 2];
}

TableSums SumsOfTable(const std::uint32_t* counts, std::size_t classes, std::size_t length, bool smoothed) {
  const Counts c;
  const std::size_t lanes = hn::Lanes(c);
  alignas(64) std::uint32_t joint[TableSums::longest_row], columns[TableSums::longest_row] = {},
                                                           rows[TableSums::longest_row] = {},
                                                           across[3][TableSums::longest_row + TableSums::slack];
  TableSums sums;
  const auto row = [&](std::size_t i) { return counts + i * length; };
  if (smoothed) {
    smooth_row(row(0), classes, length, across[0]);
    std::copy_n(across[0], length, across[2]);  // above the first
  }
  for (std::size_t i = 0; i < classes; ++i) {
    if (smoothed) {
      if (i + 1 < classes)
        smooth_row(row(i + 1), classes, length, across[(i + 1) % 3]);
      else
        std::copy_n(across[i % 3], length, across[(i + 1) % 3]);
    }
    auto total = hn::Zero(c), most = hn::Zero(c);
    for (std::size_t j = 0; j < length; j += lanes) {
      auto cells = hn::LoadU(c, row(i) + j);
      if (smoothed) {
        const auto here = hn::LoadU(c, &across[i % 3][j]);
        cells = hn::Add(hn::Add(hn::LoadU(c, &across[(i + 2) % 3][j]), hn::LoadU(c, &across[(i + 1) % 3][j])),
                        hn::Add(here, here));
      }
      cells = hn::IfThenElseZero(hn::FirstN(c, classes > j ? classes - j : 0), cells);
      hn::StoreU(cells, c, joint + j);
      hn::StoreU(hn::Add(hn::LoadU(c, columns + j), cells), c, columns + j);
      total = hn::Add(total, cells);
      most = hn::Max(most, cells);
    }
    rows[i] = hn::GetLane(hn::SumOfLanes(c, total));
    sums.points += rows[i];
    sums.joint += sum_x_log_x(joint, length, hn::GetLane(hn::MaxOfLanes(c, most)));
  }
  sums.rows = sum_of_logs(rows, length);
  sums.columns = sum_of_logs(columns, length);
  return sums;
}

const char* TargetName() { return hwy::TargetName(HWY_TARGET); }

}  // namespace HWY_NAMESPACE
}  // namespace calib::simd
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace calib::simd {

const std::array<double, 4096> x_log_x = [] {
  std::array<double, 4096> values{};
  for (std::size_t x = 1; x < values.size(); ++x) values[x] = static_cast<double>(x) * std::log(static_cast<double>(x));
  return values;
}();

HWY_EXPORT(Project);
HWY_EXPORT(Count);
HWY_EXPORT(SumsOfTable);
HWY_EXPORT(TargetName);

void project(const PointBlock& block, const Projection& projection, bool with_tiles, ProjectedPoints& projected) {
  HWY_DYNAMIC_DISPATCH(Project)(block, projection, with_tiles, projected);
}

void count(const ProjectedPoints& projected, const CountsShape& shape, bool tiled, std::uint32_t* counts) {
  HWY_DYNAMIC_DISPATCH(Count)(projected, shape, tiled, counts);
}

TableSums sums_of_table(const std::uint32_t* counts, std::size_t classes, std::size_t length, bool smoothed) {
  return HWY_DYNAMIC_DISPATCH(SumsOfTable)(counts, classes, length, smoothed);
}

const char* target_name() { return HWY_DYNAMIC_DISPATCH(TargetName)(); }

}  // namespace calib::simd
#endif
