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

/// A term, resolved for one frame.
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
  [[nodiscard]] bool possible() const {
    return rows != nullptr && !rows->empty() && (packed != nullptr || !plane->empty());
  }

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
      case FeaturePair::edges:
        return;  // is not counted
    }
  }
};

/// Scratch memory of a thread, kept between calls.
struct Scratch {
  ProjectedPoints projected;
  std::vector<Counting> countings;
  std::array<std::vector<std::uint32_t>, Objective::most_terms> counts;
};

/// Information of one table of `n` counts; none (1 when normalised, else 0) when all are in one class.
double information(const simd::TableSums& sums, bool normalised) {
  const double n = sums.points, n_log_n = n * std::log(n);
  const auto entropy = [&](double sum_x_log_x) { return (n_log_n - sum_x_log_x) / n; };
  const double both = entropy(sums.joint), each = entropy(sums.rows) + entropy(sums.columns);
  if (!normalised) return each - both;
  return both > 0 ? each / both : 1;
}

Score score_term(const Term& term, const Counting& counting, const std::vector<std::uint32_t>& counts) {
  // A tile with fewer points than this carries no information; its points are weighted as such.
  const std::size_t least = counting.tiled ? 30 : min_scored_points;
  const double nothing = term.normalised ? 1 : 0;
  Score sum;
  for (int table = 0; table < counting.tables; ++table) {
    const std::uint32_t* from = counts.data() + (static_cast<std::size_t>(table) << counting.shape.table_shift);
    const simd::TableSums sums =
        simd::sums_of_table(from, counting.classes, 1 << counting.shape.row_shift, term.normalised);
    const std::size_t points = term.normalised ? sums.points / 16 : sums.points;
    sum.value += (points >= least ? information(sums, term.normalised) : nothing) * static_cast<double>(points);
    sum.points += points;
  }
  if (sum.points < min_scored_points) return {nothing, sum.points};
  sum.value /= static_cast<double>(sum.points);
  return sum;
}

Score score_edges(const FeatureSet& frame, const Projection& projection) {
  const auto& T = projection.T_camera_points;
  const BearingGrid& grid = projection.grid;
  const ContrastPlane& plane = frame.planes->contrast;
  const float per_column = 1 / static_cast<float>(plane.cell_columns),
              per_row = 1 / static_cast<float>(plane.cell_rows);
  std::uint64_t sum = 0;
  Score score{1, 0};
  for (std::size_t i = 0; i < frame.edge_x.size(); ++i) {
    const float x = frame.edge_x[i], y = frame.edge_y[i], z = frame.edge_z[i];
    const float x_camera = T[0] * x + T[1] * y + T[2] * z + T[3], y_camera = T[4] * x + T[5] * y + T[6] * z + T[7];
    const float z_camera = T[8] * x + T[9] * y + T[10] * z + T[11];
    float denominator = z_camera;
    if (grid.xi != 0)
      denominator += grid.xi * std::sqrt(x_camera * x_camera + y_camera * y_camera + z_camera * z_camera);
    if (!(denominator > 1e-6F)) continue;
    const float column = (grid.fx * x_camera / denominator + grid.cx + 0.5F) * per_column;
    const float row = (grid.fy * y_camera / denominator + grid.cy + 0.5F) * per_row;
    if (!(column >= 0 && row >= 0 && column < static_cast<float>(plane.width) &&
          row < static_cast<float>(plane.height)))
      continue;
    const std::uint8_t rank =
        plane.rank[static_cast<std::size_t>(row) * plane.width + static_cast<std::size_t>(column)];
    if (rank == FeatureSet::none) continue;
    sum += rank;
    ++score.points;
  }
  if (score.points == 0) return score;
  const double mean = static_cast<double>(sum) / static_cast<double>(score.points * (FeatureSet::ranks - 1));
  // In a scene with few edges a point more or less must not change the score at a blow.
  const double carries = std::clamp(static_cast<double>(score.points) / min_scored_edges - 1, 0.0, 1.0);
  score.value = 1 + carries * (mean - 0.5);
  return score;
}

Projection projection_of(const FeatureSet& features, const RigidTransform& T_camera_lidar) {
  Projection projection{.T_camera_points = {}, .grid = features.planes->grid};
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 4; ++j)
      projection.T_camera_points[i * 4 + j] =
          static_cast<float>(T_camera_lidar.matrix()(i, j)) * (j < 3 ? features.unit_m : 1);
  return projection;
}

}  // namespace

Score score(const FeatureSet& features, const RigidTransform& T_camera_lidar, const Objective& objective) {
  assert(objective.count >= 1 && objective.count <= static_cast<int>(Objective::most_terms) && objective.stride >= 1);
  static thread_local Scratch scratch;
  std::vector<Counting>& countings = scratch.countings;
  countings.clear();
  bool with_tiles = false;
  for (const Term& term : objective.all()) {
    const Counting& counting = countings.emplace_back(term, features);
    with_tiles |= counting.tiled;
    const std::size_t size =
        (static_cast<std::size_t>(counting.tables) << counting.shape.table_shift) + simd::TableSums::slack;
    scratch.counts[countings.size() - 1].assign(counting.possible() ? size : 0, 0);
  }

  // The ranks that the terms need, each once.
  std::array<const Ranks*, PointBlock::most_features> rows{};
  for (Counting& counting : countings) {
    if (!counting.possible()) continue;
    const auto at = std::ranges::find_if(rows, [&](const Ranks* ranks) { return !ranks || ranks == counting.rows; });
    *at = counting.rows;
    counting.shape.rank_shift = 8 * static_cast<int>(at - rows.begin());
  }

  const Projection projection = projection_of(features, T_camera_lidar);
  const std::size_t total = rows[0] == nullptr ? 0 : (features.points() + objective.stride - 1) / objective.stride;
  for (std::size_t first = 0; first < total; first += PointBlock::capacity) {
    PointBlock block{.x = &features.x[first],
                     .y = &features.y[first],
                     .z = &features.z[first],
                     .ranks = {},
                     .count = std::min(PointBlock::capacity, total - first)};
    for (std::size_t k = 0; k < rows.size(); ++k)
      if (rows[k] != nullptr) block.ranks[k] = rows[k]->data() + first;
    simd::project(block, projection, with_tiles, scratch.projected);
    const void* looked_up = nullptr;
    for (std::size_t k = 0; k < countings.size(); ++k) {
      const Counting& counting = countings[k];
      if (!counting.possible()) continue;
      if (counting.packed == nullptr) {
        simd::look_up(counting.plane->data(), scratch.projected);
        looked_up = counting.plane;
      } else if (looked_up != counting.packed) {
        simd::look_up(counting.packed->data(), scratch.projected);
        looked_up = counting.packed;
      }
      simd::count(scratch.projected, counting.shape, counting.tiled, scratch.counts[k].data());
    }
  }

  Score result;
  double weights = 0;
  for (std::size_t k = 0; k < countings.size(); ++k) {
    const Term& term = objective.terms[k];
    const Score one = term.features == FeaturePair::edges ? score_edges(features, projection)
                      : countings[k].possible()           ? score_term(term, countings[k], scratch.counts[k])
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
  return mean_scores(frames, {&T_camera_lidar, 1}, objective).front();
}

std::vector<Score> mean_scores(Frames frames, std::span<const RigidTransform> T_camera_lidar,
                               const Objective& objective) {
  std::vector<Score> means(T_camera_lidar.size());
  for (const FeatureSet* frame : frames)
    for (std::size_t i = 0; i < T_camera_lidar.size(); ++i) {
      const Score one = score(*frame, T_camera_lidar[i], objective);
      means[i].value += one.value;
      means[i].points += one.points;
    }
  for (Score& mean : means)
    if (!frames.empty()) mean.value /= static_cast<double>(frames.size());
  return means;
}

std::string_view vector_instructions() { return simd::target_name(); }

}  // namespace calib
