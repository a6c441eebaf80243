#include "edges.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>

#include "ranks.hpp"

namespace calib {
namespace {

/// A jump of range is larger than this, and than this share of the range: more than what an oblique surface gives.
constexpr float least_jump_m = 0.3F, least_jump_share = 0.03F;
/// Further away, points are too far apart to show where a thing ends.
constexpr float farthest_edge_m = 80;
/// Behind what ends before the sky nothing is measured; nor is anything where a dark thing far away answers at times.
constexpr float farthest_before_nothing_m = 60;
/// Points are neighbours up to so many times the usual distance between neighbours: beyond, nothing was measured.
constexpr float farthest_neighbour = 3;
/// The neighbour to a side is the nearest point (of bearing) in a sector of this slope about the horizontal: of the
/// same ring, where the scan has rings.
constexpr float sector_slope = 0.3F;
constexpr float sector_reach_rad = 1.5F * static_cast<float>(radians_per_degree);

struct Bearing {
  float azimuth_rad, elevation_rad, range_m;
};

/// Bearings by cells of a grid over azimuth and elevation, without the crowded cells: those with more points than any
/// LiDAR measures there. Points of one cell are compared with each other, which would take hours.
class BearingIndex {
 public:
  explicit BearingIndex(std::span<const Bearing> bearings) {
    for (const Bearing& b : bearings) {
      left_ = std::min(left_, b.azimuth_rad);
      bottom_ = std::min(bottom_, b.elevation_rad);
    }
    for (const Bearing& b : bearings) {
      columns_ = std::max(columns_, column(b) + 1);
      rows_ = std::max(rows_, row(b) + 1);
    }
    begin_.assign(static_cast<std::size_t>(columns_) * rows_ + 1, 0);
    extents_.resize(rows_);
    std::vector<std::uint32_t> cells;
    cells.reserve(bearings.size());
    for (const Bearing& b : bearings) {
      const int u = column(b), v = row(b);
      cells.push_back(static_cast<std::uint32_t>(v * columns_ + u));
      ++begin_[cells.back() + 1];
      extents_[v].first = std::min(extents_[v].first, u);
      extents_[v].last = std::max(extents_[v].last, u);
    }
    for (std::size_t i = 1; i < begin_.size(); ++i)
      begin_[i] = begin_[i - 1] + (begin_[i] > most_in_cell ? 0 : begin_[i]);
    std::vector<std::uint32_t> next(begin_.begin(), begin_.end() - 1);
    sorted_.resize(begin_.back());
    for (std::size_t i = 0; i < bearings.size(); ++i)
      if (const std::uint32_t cell = cells[i]; begin_[cell] < begin_[cell + 1])
        sorted_[next[cell]++] = {bearings[i], static_cast<std::uint32_t>(i)};
  }

  struct Entry {
    Bearing bearing;
    std::uint32_t at;  // among the bearings that were given
  };
  /// Cell by cell.
  [[nodiscard]] std::span<const Entry> entries() const { return sorted_; }

  struct Neighbour {
    float distance_rad = std::numeric_limits<float>::infinity(), range_m = 0;
  };
  /// The neighbour to the left (-1) or right (1) of a bearing; infinitely far where there is none within reach.
  [[nodiscard]] Neighbour neighbour(const Bearing& of, int side) const {
    constexpr int step = 3;  // columns at a time
    const float shrink = std::cos(of.elevation_rad);
    const int u = column(of), v = row(of);
    float least = std::numeric_limits<float>::infinity(), range_m = 0;
    for (int k = 0; static_cast<float>(k - 1) * cell_rad < sector_reach_rad; k += step) {
      const float nearer = static_cast<float>(k - 1) * cell_rad * shrink;  // than what follows
      if (k > 0 && least < nearer * nearer) break;
      const int from = std::max(0, side < 0 ? u - k - step + 1 : u + k);
      const int to = std::min(columns_ - 1, side < 0 ? u - k : u + k + step - 1);
      if (from > to) break;
      const int spread = static_cast<int>(sector_slope * static_cast<float>(k + step)) + 1;
      for (int row = std::max(0, v - spread); row <= std::min(rows_ - 1, v + spread); ++row) {
        const std::uint32_t* begin = &begin_[static_cast<std::size_t>(row) * columns_];
        for (std::uint32_t i = begin[from]; i < begin[to + 1]; ++i) {
          const Bearing& other = sorted_[i].bearing;
          const float aside = static_cast<float>(side) * (other.azimuth_rad - of.azimuth_rad) * shrink;
          const float above = other.elevation_rad - of.elevation_rad;
          if (!(aside > 0) || aside > sector_reach_rad || std::abs(above) > sector_slope * aside) continue;
          const float squared = aside * aside + above * above;
          if (squared < least || (squared == least && other.range_m < range_m)) {
            least = squared;
            range_m = other.range_m;
          }
        }
      }
    }
    return {std::sqrt(least), range_m};
  }

  /// Whether something is measured further to the left (-1) or right (1) than `reach_rad`: else it is where the LiDAR's
  /// view ends.
  [[nodiscard]] bool goes_on(const Bearing& from, int side, float reach_rad) const {
    const int u = column(from), v = row(from), away = static_cast<int>(reach_rad / cell_rad) + 1;
    for (int i = std::max(0, v - 1); i <= std::min(rows_ - 1, v + 1); ++i)
      if (side < 0 ? extents_[i].first < u - away : extents_[i].last > u + away) return true;
    return false;
  }

 private:
  struct Extent {
    int first = std::numeric_limits<int>::max(), last = -1;
  };
  static constexpr std::uint32_t most_in_cell = 64;
  static constexpr float cell_rad = 0.2F * static_cast<float>(radians_per_degree);
  [[nodiscard]] int column(const Bearing& b) const { return static_cast<int>((b.azimuth_rad - left_) / cell_rad); }
  [[nodiscard]] int row(const Bearing& b) const { return static_cast<int>((b.elevation_rad - bottom_) / cell_rad); }

  float left_ = 4, bottom_ = 4;
  int columns_ = 0, rows_ = 0;
  std::vector<std::uint32_t> begin_;
  std::vector<Entry> sorted_;
  std::vector<Extent> extents_;  // columns of each row's points
};

float median(std::vector<float> values) {
  if (values.empty()) return 0;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::ranges::nth_element(values, middle);
  return *middle;
}

/// Means over the cells of a plane.
std::vector<float> shrunk(const std::vector<float>& grey, int width, const ContrastPlane& plane) {
  std::vector<float> cells(static_cast<std::size_t>(plane.width) * plane.height);
  for (int row = 0; row < plane.height; ++row)
    for (int column = 0; column < plane.width; ++column) {
      float sum = 0;
      for (int v = row * plane.cell_rows; v < (row + 1) * plane.cell_rows; ++v)
        for (int u = column * plane.cell_columns; u < (column + 1) * plane.cell_columns; ++u)
          sum += grey[static_cast<std::size_t>(v) * width + u];
      cells[static_cast<std::size_t>(row) * plane.width + column] = sum;
    }
  return cells;
}

/// Magnitude of the derivative along rows of what a Gaussian of one cell has smoothed, up to scale; exactly 0 where a
/// row is even; NaN where a value is missing.
std::vector<float> horizontal_gradient(const std::vector<float>& cells, int width, int height) {
  constexpr int radius = 3;
  std::array<float, radius + 1> gauss{};
  for (int k = 0; k <= radius; ++k) gauss[k] = std::exp(-0.5F * static_cast<float>(k * k));
  std::vector<float> smooth(cells.size()), gradient(cells.size());
  const auto row_of = [&](int v) { return &cells[static_cast<std::size_t>(std::clamp(v, 0, height - 1)) * width]; };
  for (int v = 0; v < height; ++v) {
    float* to = &smooth[static_cast<std::size_t>(v) * width];
    for (int u = 0; u < width; ++u) to[u] = gauss[0] * row_of(v)[u];
    for (int k = 1; k <= radius; ++k) {
      const float *above = row_of(v - k), *below = row_of(v + k);
      for (int u = 0; u < width; ++u) to[u] += gauss[k] * (above[u] + below[u]);
    }
  }
  for (int v = 0; v < height; ++v) {
    const float* row = &smooth[static_cast<std::size_t>(v) * width];
    for (int u = 0; u < width; ++u) {
      float sum = 0;
      for (int k = 1; k <= radius; ++k)
        sum += static_cast<float>(k) * gauss[k] * (row[std::min(u + k, width - 1)] - row[std::max(u - k, 0)]);
      gradient[static_cast<std::size_t>(v) * width + u] = std::abs(sum);
    }
  }
  return gradient;
}

/// Each tile of the image is ranked by itself: else a row of trees outweighs everything else.
void rank_by_tiles(const std::vector<float>& values, ContrastPlane& plane) {
  constexpr std::size_t fewest = 64;
  plane.rank.assign(values.size(), FeatureSet::none);
  std::vector<std::size_t> where;
  std::vector<float> tile;
  for (int row = 0; row < FeatureSet::tile_rows; ++row)
    for (int column = 0; column < FeatureSet::tile_columns; ++column) {
      where.clear();
      tile.clear();
      for (int v = row * plane.height / FeatureSet::tile_rows; v < (row + 1) * plane.height / FeatureSet::tile_rows;
           ++v)
        for (int u = column * plane.width / FeatureSet::tile_columns;
             u < (column + 1) * plane.width / FeatureSet::tile_columns; ++u) {
          const std::size_t i = static_cast<std::size_t>(v) * plane.width + u;
          if (std::isnan(values[i])) continue;
          where.push_back(i);
          tile.push_back(values[i]);
        }
      if (tile.size() < fewest) continue;
      const RankClassifier rank_of(equal_population_limits(tile));
      for (std::size_t i = 0; i < where.size(); ++i) plane.rank[where[i]] = rank_of(tile[i]);
    }
}

}  // namespace

std::vector<std::size_t> range_edges(std::span<const Eigen::Vector3f> points, const RigidTransform& T_camera_lidar) {
  if (points.empty()) return {};
  const Eigen::Matrix3f R_camera_lidar = T_camera_lidar.linear().cast<float>();
  std::vector<Bearing> bearings;
  bearings.reserve(points.size());
  for (const Eigen::Vector3f& point : points) {
    const Eigen::Vector3f p = R_camera_lidar * point;
    bearings.push_back({std::atan2(p.x(), p.z()), std::atan2(p.y(), std::hypot(p.x(), p.z())), p.norm()});
  }
  const BearingIndex index(bearings);
  std::vector<std::array<BearingIndex::Neighbour, 2>> neighbours;
  std::vector<float> distances;
  neighbours.reserve(points.size());
  distances.reserve(2 * points.size());
  for (const auto& [bearing, at] : index.entries()) {
    neighbours.push_back({index.neighbour(bearing, -1), index.neighbour(bearing, 1)});
    for (const auto& neighbour : neighbours.back())
      if (std::isfinite(neighbour.distance_rad)) distances.push_back(neighbour.distance_rad);
  }
  if (distances.empty()) return {};
  const float reach = farthest_neighbour * median(std::move(distances));
  std::vector<std::size_t> edges;
  for (std::size_t i = 0; i < neighbours.size(); ++i) {
    const auto& [bearing, at] = index.entries()[i];
    const float jump_m = std::max(least_jump_m, least_jump_share * bearing.range_m);
    const auto ends = [&, &bearing = bearing](int side) {
      const BearingIndex::Neighbour& neighbour = neighbours[i][side < 0 ? 0 : 1];
      if (neighbour.distance_rad <= reach)
        return bearing.range_m < farthest_edge_m && neighbour.range_m - bearing.range_m > jump_m;
      return bearing.range_m < farthest_before_nothing_m && index.goes_on(bearing, side, reach);
    };
    if (ends(-1) || ends(1)) edges.push_back(at);
  }
  std::ranges::sort(edges);
  return edges;
}

ContrastPlane contrast_of(const std::vector<float>& grey, const BearingGrid& grid) {
  ContrastPlane plane;
  if (grey.empty()) return plane;
  const auto cell = [](float pixels_per_rad) {
    return std::max(1, static_cast<int>(std::lround(ContrastPlane::cell_rad * pixels_per_rad)));
  };
  // A stereographic grid has fx / (1 + xi) pixels per rad in its middle.
  plane.cell_columns = cell(grid.fx / (1 + grid.xi));
  plane.cell_rows = cell(grid.fy / (1 + grid.xi));
  plane.width = grid.width / plane.cell_columns;
  plane.height = grid.height / plane.cell_rows;
  rank_by_tiles(horizontal_gradient(shrunk(grey, grid.width, plane), plane.width, plane.height), plane);
  return plane;
}

}  // namespace calib
