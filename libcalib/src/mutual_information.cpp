#include "calib/mutual_information.hpp"

#include <algorithm>
#include <bit>
#include <cassert>
#include <cmath>
#include <vector>

#include "joint_histogram.hpp"

namespace calib {
namespace {

using Ranks = std::vector<std::uint8_t>;

/// A term, made out for one frame.
struct Counting {
  Counting(const Term& term, const FeatureSet& frame)
      : classes(FeatureSet::ranks / term.ranks_per_class), tiled(term.features == FeaturePair::tiled_depth) {
    assert(std::has_single_bit(static_cast<unsigned>(term.ranks_per_class)) && term.ranks_per_class <= 16);
    shape.class_shift = std::countr_zero(static_cast<unsigned>(term.ranks_per_class));
    shape.row_shift = std::bit_width(static_cast<unsigned>(FeatureSet::none >> shape.class_shift));
    shape.table_shift = 2 * shape.row_shift;
    tables = tiled ? FeatureSet::tile_columns * FeatureSet::tile_rows : 1;
    choose(term.features, frame);
  }
  [[nodiscard]] bool possible() const { return !rows->empty() && (packed != nullptr || !plane->empty()); }

  int classes, tables = 1;
  bool tiled;
  CountsShape shape{};
  const Ranks* rows = nullptr;
  /// The pixels' plane: one of both.
  const std::vector<std::uint16_t>* packed = nullptr;
  const Ranks* plane = nullptr;

 private:
  void choose(FeaturePair features, const FeatureSet& frame) {
    const FeaturePlanes& planes = *frame.planes;
    const auto among_packed = [&](const Ranks& of_points, const PackedClass& where) {
      assert(shape.class_shift >= where.class_shift);
      const int coarser = shape.class_shift - where.class_shift;
      rows = &of_points;
      packed = &planes.packed;
      shape.value_shift = where.shift + coarser;
      shape.value_mask = static_cast<int>(where.mask() >> coarser);
    };
    const auto in_plane = [&](const Ranks& of_points, const Ranks& of_pixels) {
      rows = &of_points;
      plane = &of_pixels;
      shape.value_shift = shape.class_shift;
      shape.value_mask = FeatureSet::none >> shape.class_shift;
    };
    switch (features) {
      case FeaturePair::depth:
        return among_packed(frame.range_rank, FeaturePlanes::depth);
      case FeaturePair::tiled_depth:
        return among_packed(frame.range_rank, FeaturePlanes::tile_depth);
      case FeaturePair::intensity:
        return among_packed(frame.reflectance_rank, FeaturePlanes::grey);
      case FeaturePair::fine_intensity:
        return in_plane(frame.reflectance_rank, planes.grey_rank);
      case FeaturePair::linear_depth:
        return in_plane(frame.range_linear, planes.depth_linear);
      case FeaturePair::linear_intensity:
        return in_plane(frame.reflectance_linear, planes.grey_linear);
    }
  }
};

/// Scratch memory of a thread, kept between calls.
struct Scratch {
  Landed landed;
  std::vector<Counting> countings;
  std::array<std::vector<std::uint32_t>, 3> counts;
  std::vector<double> across, joint, row_sums, column_sums;
};

/// The joint counts of a table without its column of no value, smoothed with [1 2 1] / 4 in both directions (beyond the
/// edge is what is at the edge) when wanted; into `scratch.joint`, with its sums.
void prepare_table(const std::uint32_t* counts, int classes, int row_shift, bool smoothed, Scratch& scratch) {
  const auto n = static_cast<std::size_t>(classes);
  scratch.across.resize(n * n);
  scratch.joint.resize(n * n);
  double* across = scratch.across.data();
  double* joint = scratch.joint.data();
  for (std::size_t i = 0; i < n; ++i) {
    const std::uint32_t* row = counts + (i << row_shift);
    double* to = (smoothed ? across : joint) + i * n;
    for (std::size_t j = 0; j < n; ++j) to[j] = row[j];
    if (!smoothed) continue;
    to[0] = 3.0 * row[0] + row[1];
    for (std::size_t j = 1; j + 1 < n; ++j) to[j] = row[j - 1] + 2.0 * row[j] + row[j + 1];
    to[n - 1] = row[n - 2] + 3.0 * row[n - 1];
  }
  if (smoothed)
    for (std::size_t i = 0; i < n; ++i) {
      const double *above = across + (i == 0 ? 0 : i - 1) * n, *here = across + i * n,
                   *below = across + std::min(i + 1, n - 1) * n;
      for (std::size_t j = 0; j < n; ++j) joint[i * n + j] = above[j] + 2 * here[j] + below[j];
    }
  scratch.row_sums.assign(n, 0);
  scratch.column_sums.assign(n, 0);
  for (std::size_t i = 0; i < n; ++i)
    for (std::size_t j = 0; j < n; ++j) {
      scratch.row_sums[i] += joint[i * n + j];
      scratch.column_sums[j] += joint[i * n + j];
    }
}

std::size_t points_in_table(const std::uint32_t* counts, int classes, int row_shift) {
  std::size_t points = 0;
  for (int i = 0; i < classes; ++i)
    for (int j = 0; j < classes; ++j) points += counts[(static_cast<std::size_t>(i) << row_shift) + j];
  return points;
}

/// Information of one table; none (1 when normalised, else 0) when all points are in one class.
double information(const Term& term, Scratch& scratch, double points) {
  const double n = term.normalised ? 16 * points : points;  // smoothing counts a point sixteen times
  const double n_log_n = n * std::log(n);
  const auto entropy = [&](const std::vector<double>& values) {
    return (n_log_n - simd::sum_x_log_x(values.data(), values.size())) / n;
  };
  const double both = entropy(scratch.joint), each = entropy(scratch.row_sums) + entropy(scratch.column_sums);
  if (!term.normalised) return each - both;
  return both > 0 ? each / both : 1;
}

Score score_term(const Term& term, const Counting& counting, const std::vector<std::uint32_t>& counts,
                 Scratch& scratch) {
  // A tile with fewer points than this says nothing; its points count as knowing nothing.
  const std::size_t least = counting.tiled ? 30 : min_scored_points;
  const double nothing = term.normalised ? 1 : 0;
  Score sum;
  for (int table = 0; table < counting.tables; ++table) {
    const std::uint32_t* from = counts.data() + (static_cast<std::size_t>(table) << counting.shape.table_shift);
    const std::size_t points = points_in_table(from, counting.classes, counting.shape.row_shift);
    double value = nothing;
    if (points >= least) {
      prepare_table(from, counting.classes, counting.shape.row_shift, term.normalised, scratch);
      value = information(term, scratch, static_cast<double>(points));
    }
    sum.value += value * static_cast<double>(points);
    sum.points += points;
  }
  if (sum.points < min_scored_points) return {nothing, sum.points};
  sum.value /= static_cast<double>(sum.points);
  return sum;
}

Projection projection_of(const FeatureSet& features, const RigidTransform& T_camera_lidar) {
  Projection projection{.T_camera_lidar = {}, .grid = features.planes->grid};
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 4; ++j)
      projection.T_camera_lidar[i * 4 + j] = static_cast<float>(T_camera_lidar.matrix()(i, j));
  return projection;
}

}  // namespace

Score score(const FeatureSet& features, const RigidTransform& T_camera_lidar, const Objective& objective) {
  assert(objective.count >= 1 && objective.count <= 3 && objective.stride >= 1);
  static thread_local Scratch scratch;
  std::vector<Counting>& countings = scratch.countings;
  countings.clear();
  bool with_tiles = false;
  for (const Term& term : objective.all()) {
    const Counting& counting = countings.emplace_back(term, features);
    with_tiles |= counting.tiled;
    const std::size_t size = static_cast<std::size_t>(counting.tables) << counting.shape.table_shift;
    scratch.counts[countings.size() - 1].assign(counting.possible() ? size : 0, 0);
  }

  const Projection projection = projection_of(features, T_camera_lidar);
  const std::size_t total = (features.points() + objective.stride - 1) / objective.stride;
  for (std::size_t first = 0; first < total; first += Landed::capacity) {
    const std::size_t count = std::min(Landed::capacity, total - first);
    simd::project(features, first, count, projection, with_tiles, scratch.landed);
    const void* looked_up = nullptr;
    for (std::size_t k = 0; k < countings.size(); ++k) {
      const Counting& counting = countings[k];
      if (!counting.possible()) continue;
      if (counting.packed == nullptr) {
        simd::look_up(counting.plane->data(), scratch.landed);
        looked_up = counting.plane;
      } else if (looked_up != counting.packed) {
        simd::look_up(counting.packed->data(), scratch.landed);
        looked_up = counting.packed;
      }
      simd::count(scratch.landed, counting.rows->data() + first, counting.shape, counting.tiled,
                  scratch.counts[k].data());
    }
  }

  Score result;
  double weights = 0;
  for (std::size_t k = 0; k < countings.size(); ++k) {
    const Term& term = objective.terms[k];
    const Score one = countings[k].possible() ? score_term(term, countings[k], scratch.counts[k], scratch)
                                              : Score{term.normalised ? 1.0 : 0.0, 0};
    result.value += term.weight * one.value;
    weights += term.weight;
    if (k == 0) result.points = one.points;
  }
  assert(weights > 0);
  result.value /= weights;
  return result;
}

Score mean_score(Frames frames, const RigidTransform& T_camera_lidar, const Objective& objective) {
  Score mean;
  for (const FeatureSet* frame : frames) {
    const Score one = score(*frame, T_camera_lidar, objective);
    mean.value += one.value;
    mean.points += one.points;
  }
  if (!frames.empty()) mean.value /= static_cast<double>(frames.size());
  return mean;
}

std::string_view vector_instructions() { return simd::target_name(); }

}  // namespace calib
