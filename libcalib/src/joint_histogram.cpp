#include "joint_histogram.hpp"

#include <algorithm>

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

/// Appends those of a vector of points that are in view, of which `known` are points at all.
HWY_INLINE void project_vector(const float* x_m, const float* y_m, const float* z_m, std::size_t first,
                               std::size_t known, const Projection& projection, bool with_tiles,
                               ProjectedPoints& projected) {
  const Floats f;
  const Ints ints;
  const auto& T = projection.T_camera_lidar;
  const BearingGrid& grid = projection.grid;
  const auto x = hn::LoadU(f, x_m), y = hn::LoadU(f, y_m), z = hn::LoadU(f, z_m);
  const auto row = [&](int i) HWY_ATTR {
    return hn::MulAdd(hn::Set(f, T[i]), x,
                      hn::MulAdd(hn::Set(f, T[i + 1]), y, hn::MulAdd(hn::Set(f, T[i + 2]), z, hn::Set(f, T[i + 3]))));
  };
  const auto x_camera = row(0), y_camera = row(4), z_camera = row(8);
  auto denominator = z_camera;
  if (grid.xi != 0) {
    const auto squared = hn::MulAdd(x_camera, x_camera, hn::MulAdd(y_camera, y_camera, hn::Mul(z_camera, z_camera)));
    denominator = hn::MulAdd(hn::Set(f, grid.xi), hn::Sqrt(squared), z_camera);
  }
  const auto inverse = hn::Div(hn::Set(f, 1), denominator);
  // Half a pixel more, so that truncation rounds to the nearest.
  const auto u = hn::MulAdd(hn::Mul(hn::Set(f, grid.fx), x_camera), inverse, hn::Set(f, grid.cx + 0.5F));
  const auto v = hn::MulAdd(hn::Mul(hn::Set(f, grid.fy), y_camera), inverse, hn::Set(f, grid.cy + 0.5F));
  const auto width = hn::Set(f, static_cast<float>(grid.width)), height = hn::Set(f, static_cast<float>(grid.height));
  const auto zero = hn::Zero(f);
  // Comparisons with NaN are false, so that what is not a number is not in view.
  const auto in_front = hn::Gt(denominator, hn::Set(f, 1e-6F));
  const auto in_view = hn::And(hn::And(in_front, hn::And(hn::Ge(u, zero), hn::Lt(u, width))),
                               hn::And(hn::Ge(v, zero), hn::Lt(v, height)));
  const auto seen = hn::And(hn::RebindMask(ints, in_view), hn::FirstN(ints, known));
  const auto u_seen = hn::IfThenElseZero(in_view, u), v_seen = hn::IfThenElseZero(in_view, v);
  const auto column = hn::ConvertTo(ints, u_seen), line = hn::ConvertTo(ints, v_seen);
  const auto place = hn::Add(hn::Mul(line, hn::Set(ints, grid.width)), column);
  const std::size_t end = projected.count;
  projected.count += hn::CountTrue(ints, seen);
  const LanesInFront seen_first(seen);
  const auto append = [&](auto values, auto& to) HWY_ATTR { hn::StoreU(seen_first(values), ints, &to[end]); };
  append(place, projected.pixel);
  append(hn::Iota(ints, static_cast<std::int32_t>(first)), projected.point);
  if (!with_tiles) return;
  const auto tile_of = [&](auto pixel, int tiles, int extent) HWY_ATTR {
    const auto scale = hn::Set(f, static_cast<float>(tiles) / static_cast<float>(extent));
    const auto middle = hn::Add(hn::ConvertTo(f, pixel), hn::Set(f, 0.5F));
    return hn::Min(hn::ConvertTo(ints, hn::Mul(middle, scale)), hn::Set(ints, tiles - 1));
  };
  const auto across = tile_of(column, FeatureSet::tile_columns, grid.width);
  const auto down = tile_of(line, FeatureSet::tile_rows, grid.height);
  append(hn::Add(hn::Mul(down, hn::Set(ints, FeatureSet::tile_columns)), across), projected.tile);
}

void Project(const FeatureSet& features, std::size_t first, std::size_t count, const Projection& projection,
             bool with_tiles, ProjectedPoints& projected) {
  constexpr std::size_t most_lanes = HWY_MAX_BYTES / sizeof(float);
  static_assert(most_lanes <= ProjectedPoints::slack);
  const std::size_t lanes = hn::Lanes(Floats());
  const float *x = &features.x_m[first], *y = &features.y_m[first], *z = &features.z_m[first];
  projected.count = 0;
  std::size_t i = 0;
  for (; i + lanes <= count; i += lanes)
    project_vector(x + i, y + i, z + i, i, lanes, projection, with_tiles, projected);
  if (i == count) return;
  float rest[3][most_lanes] = {};
  for (std::size_t k = i; k < count; ++k) {
    rest[0][k - i] = x[k];
    rest[1][k - i] = y[k];
    rest[2][k - i] = z[k];
  }
  project_vector(rest[0], rest[1], rest[2], i, count - i, projection, with_tiles, projected);
}

/// Sum of x log x.
HWY_INLINE double sum_x_log_x(const std::uint32_t* values, std::size_t count) {
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

/// Smooths the row with [1 2 1]; beyond the edge is what is at the edge.
HWY_INLINE void smooth_row(const std::uint32_t* row, std::size_t classes, std::size_t length, std::uint32_t* to) {
  const Counts c;
  std::uint32_t padded[1 + TableSums::longest_row + 16];
  for (std::size_t j = 0; j < length; j += hn::Lanes(c)) hn::StoreU(hn::LoadU(c, row + j), c, padded + 1 + j);
  padded[0] = row[0];
  padded[classes + 1] = row[classes - 1];
  for (std::size_t j = 0; j < length; j += hn::Lanes(c)) {
    const auto here = hn::LoadU(c, padded + 1 + j);
    hn::StoreU(hn::Add(hn::Add(hn::LoadU(c, padded + j), hn::LoadU(c, padded + 2 + j)), hn::Add(here, here)), c,
               to + j);
  }
}

TableSums SumsOfTable(const std::uint32_t* counts, std::size_t classes, std::size_t length, bool smoothed) {
  const Counts c;
  const std::size_t lanes = hn::Lanes(c);
  alignas(64) std::uint32_t joint[TableSums::longest_row],
      columns[TableSums::longest_row] = {}, rows[TableSums::longest_row] = {}, across[3][TableSums::longest_row];
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
    auto total = hn::Zero(c);
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
    }
    rows[i] = hn::GetLane(hn::SumOfLanes(c, total));
    sums.points += rows[i];
    sums.joint += sum_x_log_x(joint, length);
  }
  sums.rows = sum_x_log_x(rows, length);
  sums.columns = sum_x_log_x(columns, length);
  return sums;
}

const char* TargetName() { return hwy::TargetName(HWY_TARGET); }

}  // namespace HWY_NAMESPACE
}  // namespace calib::simd
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace calib::simd {

HWY_EXPORT(Project);
HWY_EXPORT(SumsOfTable);
HWY_EXPORT(TargetName);

void project(const FeatureSet& features, std::size_t first, std::size_t count, const Projection& projection,
             bool with_tiles, ProjectedPoints& projected) {
  HWY_DYNAMIC_DISPATCH(Project)(features, first, count, projection, with_tiles, projected);
}

namespace {
template <bool tiled>
void count_all(const ProjectedPoints& projected, const std::uint8_t* row_ranks, const CountsShape shape,
               std::uint32_t* counts) {
  for (std::size_t i = 0; i < projected.count; ++i) {
    int cell = row_ranks[projected.point[i]] >> shape.class_shift << shape.row_shift;
    cell |= projected.value[i] >> shape.value_shift & shape.value_mask;
    if constexpr (tiled) cell |= projected.tile[i] << shape.table_shift;
    ++counts[cell];
  }
}
}  // namespace

void count(const ProjectedPoints& projected, const std::uint8_t* row_ranks, const CountsShape& shape, bool tiled,
           std::uint32_t* counts) {
  if (tiled)
    count_all<true>(projected, row_ranks, shape, counts);
  else
    count_all<false>(projected, row_ranks, shape, counts);
}

TableSums sums_of_table(const std::uint32_t* counts, std::size_t classes, std::size_t length, bool smoothed) {
  return HWY_DYNAMIC_DISPATCH(SumsOfTable)(counts, classes, length, smoothed);
}

const char* target_name() { return HWY_DYNAMIC_DISPATCH(TargetName)(); }

}  // namespace calib::simd
#endif
