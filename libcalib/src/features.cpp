#include "calib/features.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <string>

#include "cull.hpp"
#include "edges.hpp"
#include "ranks.hpp"

namespace calib {
namespace {

constexpr float no_value = std::numeric_limits<float>::quiet_NaN();

/// A part of a plane: columns [left, right), rows [top, bottom).
struct Window {
  int left, top, right, bottom;
};

/// Calls `take` with the index and class of each value of a window (NaN: none), which is ranked by itself.
template <typename Take>
void classify(const std::vector<float>& values, int width, const Window& window, RankLimits limits_of,
              const Take& take) {
  // Sorting a sample is enough for 240 classes, and much quicker.
  const std::size_t area = static_cast<std::size_t>(window.right - window.left) * (window.bottom - window.top);
  const std::size_t stride = area / 16384 + 1;
  std::vector<float> sample;
  std::size_t next = 0, index = 0;
  const auto each = [&](const auto& visit) {
    for (int v = window.top; v < window.bottom; ++v)
      for (int u = window.left; u < window.right; ++u) {
        const std::size_t i = static_cast<std::size_t>(v) * width + u;
        if (!std::isnan(values[i])) visit(i);
      }
  };
  each([&](std::size_t i) {
    if (index++ != next) return;
    sample.push_back(values[i]);
    next += stride;
  });
  if (sample.size() < 64) return;  // too few for ranks
  const RankClassifier class_of(limits_of(std::move(sample)));
  each([&](std::size_t i) { take(i, class_of(values[i])); });
}

std::vector<std::uint8_t> classes(const std::vector<float>& values, const BearingGrid& grid, RankLimits limits_of) {
  if (values.empty()) return {};
  std::vector<std::uint8_t> plane(grid.pixels(), FeatureSet::none);
  classify(values, grid.width, {0, 0, grid.width, grid.height}, limits_of,
           [&](std::size_t i, std::uint8_t rank) { plane[i] = rank; });
  return plane;
}

/// Puts the classes of the values (NaN: none) into packed pixels. Each of `columns` x `rows` parts is ranked by itself.
void pack(const std::vector<float>& values, const PackedClass& where, int columns, int rows, FeaturePlanes& planes) {
  if (values.empty()) return;
  const BearingGrid& grid = planes.grid;
  // The first pixel whose middle lies in a part, which is where the vector code draws the line too.
  const auto edge = [](int part, int parts, int extent) {
    return static_cast<int>((2 * static_cast<std::int64_t>(part) * extent + parts - 1) / (2 * parts));
  };
  for (int row = 0; row < rows; ++row)
    for (int column = 0; column < columns; ++column)
      classify(values, grid.width,
               {edge(column, columns, grid.width), edge(row, rows, grid.height), edge(column + 1, columns, grid.width),
                edge(row + 1, rows, grid.height)},
               equal_population_limits,
               [&](std::size_t i, std::uint8_t rank) { planes.packed[i] = where.put(planes.packed[i], rank); });
}

std::vector<std::uint8_t> classes(const std::vector<float>& values, RankLimits limits_of) {
  std::vector<std::uint8_t> result(values.size());
  if (values.empty()) return result;
  std::vector<float> sample;
  for (std::size_t i = 0; i < values.size(); i += values.size() / 16384 + 1) sample.push_back(values[i]);
  std::ranges::transform(values, result.begin(), RankClassifier(limits_of(std::move(sample))));
  return result;
}

/// A pixel of the grid stands for so many pixels of the image in each direction. `focal` is in pixels per radian, on
/// the axis. A finer grid costs memory and time and finds nothing more: a beam of a LiDAR is 0.1 to 0.2 degrees wide.
int pixels_per_pixel(const Camera& camera, double focal) {
  constexpr double coarsest_rad = 0.003;
  constexpr int fewest_columns = 480, fewest_rows = 16;  // a long lens keeps more than the angle asks for
  const int most = std::min(camera.width() / fewest_columns, camera.height() / fewest_rows);
  return std::clamp(static_cast<int>(coarsest_rad * focal), 1, std::max(1, most));
}

/// The camera's values at each pixel of the grid; NaN where it has none.
struct Resampled {
  std::vector<float> distance;  // negative inverse distance along the ray, which grows with it
  std::vector<float> depth;     // along the optical axis, up to scale
  std::vector<float> grey;
};

/// Cosines of the angles between the optical axis and the pixels of a row, whose y is `v`; `x_squared` are the squares
/// of the columns' (u - cx) / fx.
void cosines(const BearingGrid& grid, int v, const std::vector<double>& x_squared, std::vector<double>& to) {
  const double y = (v - static_cast<double>(grid.cy)) / grid.fy;
  for (std::size_t u = 0; u < to.size(); ++u) {
    const double squared = x_squared[u] + y * y;
    to[u] = grid.xi == 0 ? 1 / std::sqrt(squared + 1) : (1 - squared) / (1 + squared);
  }
}

Resampled resample(const FramePair& pair, const DepthMap& depth, const Camera& camera, const BearingGrid& grid,
                   bool with_depth) {
  const bool rectified = camera.model() == CameraModel::rectified;
  const int step = rectified ? pixels_per_pixel(camera, camera.fx()) : 1;
  const bool with_grey = pair.image.pixels.size() == depth.inverse_depth.size();
  Resampled result;
  result.distance.assign(grid.pixels(), no_value);
  if (with_depth) result.depth.assign(grid.pixels(), no_value);
  if (with_grey) result.grey.assign(grid.pixels(), no_value);
  std::vector<double> x_squared(grid.width), forward_of_row(grid.width);
  for (int u = 0; u < grid.width; ++u) x_squared[u] = std::pow((u - static_cast<double>(grid.cx)) / grid.fx, 2);
  for (int v = 0; v < grid.height; ++v) {
    cosines(grid, v, x_squared, forward_of_row);
    for (int u = 0; u < grid.width; ++u) {
      const std::size_t to = static_cast<std::size_t>(v) * grid.width + u;
      std::size_t from = static_cast<std::size_t>(v * step + step / 2) * depth.width + u * step + step / 2;
      if (!rectified) {
        const auto uv = camera.project(grid.bearing(u, v));
        if (!uv) continue;
        // Not lround: it takes -0.5, which the camera sees, to -1.
        from = static_cast<std::size_t>(std::floor(uv->y() + 0.5)) * depth.width +
               static_cast<std::size_t>(std::floor(uv->x() + 0.5));
      }
      if (with_grey) result.grey[to] = pair.image.pixels[from];
      const float inverse = depth.inverse_depth[from], forward = static_cast<float>(forward_of_row[u]);
      if (!(inverse > DepthMap::no_depth) || (!depth.along_ray && forward <= 0)) continue;
      result.distance[to] = -(depth.along_ray ? inverse : inverse * forward);
      if (with_depth) result.depth[to] = depth.along_ray ? forward / inverse : 1 / inverse;
    }
  }
  return result;
}

/// Indices 0 .. count - 1: every 32nd, then what makes that every 16th, and so on, each part in order.
std::vector<std::size_t> even_samples_first(std::size_t count) {
  std::vector<std::size_t> order;
  order.reserve(count);
  for (std::size_t i = 0; i < count; i += 32) order.push_back(i);
  for (std::size_t step = 32; step > 1; step /= 2)
    for (std::size_t i = step / 2; i < count; i += step) order.push_back(i);
  return order;
}

/// Where distances are taken from, LiDAR frame.
Eigen::Vector3f viewpoint(const RigidTransform& T_camera_lidar, const SearchBounds& bounds) {
  if (bounds.rotation_rad >= 1) return Eigen::Vector3f::Zero();
  return T_camera_lidar.inverse().translation().cast<float>();
}

void rank_distance(const Eigen::Vector3f& from, FeatureSet& features) {
  std::vector<float> distance(features.points());
  for (std::size_t i = 0; i < distance.size(); ++i) distance[i] = (features.point(i) - from).norm();
  features.range_rank = classes(distance, equal_population_limits);
}

float unit_for(float largest_m) {
  float unit_m = std::exp2(-15.F);
  while (largest_m / unit_m > std::numeric_limits<std::int16_t>::max()) unit_m *= 2;
  return unit_m;
}

/// Rounded, halves away from zero, without a call for each.
Eigen::Vector3f in_units(const Eigen::Vector3f& point, float unit_m) {
  constexpr float below_half = 0.5F - std::numeric_limits<float>::epsilon() / 4;
  return (point / unit_m).unaryExpr([](float value) {
    return static_cast<float>(static_cast<int>(value + std::copysign(below_half, value)));
  });
}

void take_points(const LidarScan& scan, const RigidTransform& T_camera_lidar, const FeatureSettings& settings,
                 FeatureSet& features) {
  const auto position = [&](std::size_t i) {
    return Eigen::Vector3f(scan.points[i].x_m, scan.points[i].y_m, scan.points[i].z_m);
  };
  const auto furthest = [](const Eigen::Vector3f& point) { return point.cwiseAbs().maxCoeff(); };
  float largest = 0;
  std::vector<std::size_t> measured, kept;
  for (std::size_t i = 0; i < scan.points.size(); ++i) {
    if (!position(i).allFinite() || furthest(position(i)) > FeatureSet::farthest_m) continue;
    largest = std::max(largest, furthest(position(i)));
    measured.push_back(i);
  }
  const Cull cull(*features.planes, T_camera_lidar, settings.bounds);
  const float unit = unit_for(largest);
  for (const std::size_t i : measured)
    if (cull.may_be_in_view(unit * in_units(position(i), unit))) kept.push_back(i);
  std::vector<Eigen::Vector3f> points;
  std::vector<float> range, reflectance;
  points.reserve(kept.size());
  for (auto* values : {&range, &reflectance}) values->reserve(kept.size());
  for (const std::size_t i : even_samples_first(kept.size())) {
    const LidarPoint& point = scan.points[kept[i]];
    points.push_back(position(kept[i]));
    range.push_back(std::hypot(point.x_m, point.y_m, point.z_m));
    reflectance.push_back(point.reflectance);
  }
  features.set_points(points, largest);
  for (const std::size_t i : range_edges(points, T_camera_lidar)) {
    features.edge_x.push_back(features.x[i]);
    features.edge_y.push_back(features.y[i]);
    features.edge_z.push_back(features.z[i]);
  }
  rank_distance(viewpoint(T_camera_lidar, settings.bounds), features);
  features.reflectance_rank = classes(reflectance, equal_population_limits);
  if (!settings.baselines) return;
  features.range_linear = classes(range, equal_width_limits);
  features.reflectance_linear = classes(reflectance, equal_width_limits);
}

/// How many points project to pixels with depth.
int points_on_depth(const FeatureSet& features, const RigidTransform& T_camera_lidar) {
  const BearingGrid& grid = features.planes->grid;
  int count = 0;
  for (std::size_t i = 0; i < features.points(); ++i) {
    const Eigen::Vector3d p = T_camera_lidar * features.point(i).cast<double>();
    const double denominator = p.z() + grid.xi * p.norm();
    if (!(denominator > 0)) continue;
    const double u = grid.fx * p.x() / denominator + grid.cx, v = grid.fy * p.y() / denominator + grid.cy;
    if (!(u >= 0 && v >= 0 && u <= grid.width - 1 && v <= grid.height - 1)) continue;
    const auto pixel = std::lround(v) * grid.width + std::lround(u);
    count += FeaturePlanes::depth.rank(features.planes->packed[pixel]) != FeatureSet::none;
  }
  return count;
}

}  // namespace

BearingGrid BearingGrid::of(const Camera& camera) {
  BearingGrid grid;
  if (camera.model() == CameraModel::rectified) {  // the image's own pixels, or some of them in each direction
    const int step = pixels_per_pixel(camera, camera.fx()), first = step / 2;
    grid.width = (camera.width() - first - 1) / step + 1;
    grid.height = (camera.height() - first - 1) / step + 1;
    grid.fx = static_cast<float>(camera.fx() / step);
    grid.fy = static_cast<float>(camera.fy() / step);
    grid.cx = static_cast<float>((camera.cx() - first) / step);
    grid.cy = static_cast<float>((camera.cy() - first) / step);
    return grid;
  }
  // The pinhole or stereographic picture of what the image shows, as fine as the image is on the average, or coarser
  // by a whole number. The corners of a round image would claim most of it: a model goes on where the lens does not.
  constexpr double widest_rad = 115 * radians_per_degree;
  grid.xi = camera.max_angle_rad() < std::numbers::pi / 3 ? 0 : 1;
  Eigen::Vector2d least = Eigen::Vector2d::Constant(1e9), most = -least;
  for (int v = 0; v < camera.height(); ++v)
    for (int u = 0; u < camera.width(); u += v % 8 == 0 ? 1 : camera.width() - 1)  // every eighth row, and the sides
      if (const auto bearing = camera.unproject(Eigen::Vector2d(u, v));
          bearing && bearing->z() > std::cos(widest_rad) && camera.project(*bearing)) {
        const Eigen::Vector2d place = bearing->head<2>() / (bearing->z() + grid.xi);
        least = least.cwiseMin(place);
        most = most.cwiseMax(place);
      }
  const Eigen::Vector2d extent = (most - least).cwiseMax(1e-6);
  double scale = std::sqrt(camera.width() * static_cast<double>(camera.height()) / extent.prod());
  scale /= pixels_per_pixel(camera, scale / (1 + grid.xi));
  grid.width = std::max(1, static_cast<int>(std::lround(scale * extent.x())));
  grid.height = std::max(1, static_cast<int>(std::lround(scale * extent.y())));
  grid.fx = grid.fy = static_cast<float>(scale);
  grid.cx = static_cast<float>(-scale * least.x());
  grid.cy = static_cast<float>(-scale * least.y());
  return grid;
}

Eigen::Vector3d BearingGrid::bearing(double u, double v) const {
  const double x = (u - cx) / fx, y = (v - cy) / fy;
  if (xi == 0) return Eigen::Vector3d(x, y, 1).normalized();
  const double squared = x * x + y * y;  // of tan(angle / 2)
  return Eigen::Vector3d(2 * x, 2 * y, 1 - squared) / (1 + squared);
}

std::size_t FeatureSet::memory_bytes() const {
  std::size_t bytes = sizeof *this;
  for (const auto* values : {&x, &y, &z, &edge_x, &edge_y, &edge_z}) bytes += sizeof(std::int16_t) * values->capacity();
  for (const auto* values : {&range_rank, &reflectance_rank, &range_linear, &reflectance_linear})
    bytes += values->capacity();
  if (!planes) return bytes;
  bytes += sizeof *planes + sizeof(std::uint16_t) * planes->packed.capacity();
  for (const auto* values : {&planes->depth_linear, &planes->grey_linear, &planes->grey_rank, &planes->contrast.rank})
    bytes += values->capacity();
  return bytes;
}

void FeatureSet::set_points(std::span<const Eigen::Vector3f> points, float largest_m) {
  unit_m = unit_for(largest_m);
  for (auto* values : {&x, &y, &z}) {
    values->clear();
    values->reserve(points.size());
  }
  for (const Eigen::Vector3f& point : points) {
    const Eigen::Matrix<std::int16_t, 3, 1> rounded = in_units(point, unit_m).cast<std::int16_t>();
    x.push_back(rounded.x());
    y.push_back(rounded.y());
    z.push_back(rounded.z());
  }
}

FeatureSet FeatureSet::about(const RigidTransform& T_camera_lidar, const SearchBounds& bounds) const {
  FeatureSet result;
  result.stamp = stamp;
  result.planes = planes;
  const Cull cull(*planes, T_camera_lidar, bounds);
  std::vector<std::uint32_t> kept(points());
  std::size_t count = 0;
  for (std::size_t i = 0; i < points(); ++i) {
    kept[count] = static_cast<std::uint32_t>(i);
    count += cull.may_be_in_view(point(i));
  }
  kept.resize(count);
  const auto take = [&](const auto& from, auto& to) {
    if (from.empty()) return;
    to.resize(kept.size());
    std::ranges::transform(kept, to.begin(), [&](std::size_t i) { return from[i]; });
  };
  take(x, result.x);
  take(y, result.y);
  take(z, result.z);
  result.unit_m = unit_m;
  take(reflectance_rank, result.reflectance_rank);
  take(range_linear, result.range_linear);
  take(reflectance_linear, result.reflectance_linear);
  result.edge_x = edge_x;
  result.edge_y = edge_y;
  result.edge_z = edge_z;
  rank_distance(viewpoint(T_camera_lidar, bounds), result);
  return result;
}

Result<FeatureSet> make_features(const FramePair& pair, const DepthMap& depth, const Camera& camera,
                                 const RigidTransform& T_camera_lidar, const FeatureSettings& settings) {
  if (depth.width != camera.width() || depth.height != camera.height() ||
      depth.inverse_depth.size() != static_cast<std::size_t>(depth.width) * depth.height)
    return fail(ErrorCode::depth_failed, "the depth map does not have the camera's size");
  FeatureSet features;
  features.stamp = pair.scan.stamp;
  FeaturePlanes planes;
  planes.grid = BearingGrid::of(camera);
  planes.max_angle_rad = camera.max_angle_rad();
  const Resampled seen = resample(pair, depth, camera, planes.grid, settings.baselines);
  planes.packed.assign(planes.grid.pixels(), 0xFFFF);
  pack(seen.distance, FeaturePlanes::depth, 1, 1, planes);
  pack(seen.distance, FeaturePlanes::tile_depth, FeatureSet::tile_columns, FeatureSet::tile_rows, planes);
  pack(seen.grey, FeaturePlanes::grey, 1, 1, planes);
  planes.contrast = contrast_of(seen.grey, planes.grid);
  if (settings.baselines) {
    planes.depth_linear = classes(seen.depth, planes.grid, equal_width_limits);
    planes.grey_linear = classes(seen.grey, planes.grid, equal_width_limits);
    planes.grey_rank = classes(seen.grey, planes.grid, equal_population_limits);
  }
  features.planes = std::make_shared<const FeaturePlanes>(std::move(planes));
  take_points(pair.scan, T_camera_lidar, settings, features);

  const int on_depth = points_on_depth(features, T_camera_lidar);
  if (on_depth < settings.min_points)
    return fail(ErrorCode::low_overlap,
                std::to_string(on_depth) + " LiDAR points land on pixels with depth, at least " +
                    std::to_string(settings.min_points) +
                    " are needed; do camera and LiDAR look the same way, and is T_camera_lidar right?");
  return features;
}

}  // namespace calib
