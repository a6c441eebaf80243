#include "calib/features.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <limits>
#include <numbers>
#include <string>

namespace calib {
namespace {

constexpr float no_value = std::numeric_limits<float>::quiet_NaN();
constexpr int ranks = FeatureSet::ranks;

/// A part of a plane: columns [left, right), rows [top, bottom).
struct Window {
  int left, top, right, bottom;
};

/// Upper limits of equally populated classes of `values` (which it sorts): class i holds values <= limits[i].
std::vector<float> equal_population_limits(std::vector<float> values) {
  std::ranges::sort(values);
  std::vector<float> limits(ranks - 1);
  for (std::size_t i = 0; i < limits.size(); ++i) limits[i] = values[(i + 1) * values.size() / ranks];
  return limits;
}

/// Upper limits of classes of equal width from the smallest value to one that only a hundredth of them exceed: single
/// wild values would leave all others in one class.
std::vector<float> equal_width_limits(std::vector<float> values) {
  std::ranges::sort(values);
  const float least = values.front(), most = values[(values.size() - 1) * 99 / 100];
  std::vector<float> limits(ranks - 1);
  for (std::size_t i = 0; i < limits.size(); ++i)
    limits[i] = least + (most - least) * static_cast<float>(i + 1) / static_cast<float>(ranks);
  return limits;
}

using Limits = std::vector<float> (*)(std::vector<float>);

/// Finds a value's class: that of the first limit which is not below it. A table over the bits of floats, which grow
/// with the number, says where to begin to look.
class Classifier {
 public:
  explicit Classifier(std::vector<float> limits) : limits_(std::move(limits)), first_(ordered(limits_.front())) {
    const std::uint32_t span = ordered(limits_.back()) - first_;
    while (span >> shift_ >= table_size) ++shift_;
    std::uint8_t at = 0;
    for (std::size_t entry = 0; entry < table_size; ++entry) {
      while (at < limits_.size() && (ordered(limits_[at]) - first_) >> shift_ < entry) ++at;
      begin_[entry] = at;
    }
  }

  [[nodiscard]] std::uint8_t operator()(float value) const {
    if (value <= limits_.front()) return 0;
    const std::uint32_t entry = (ordered(value) - first_) >> shift_;
    std::uint8_t at = begin_[std::min<std::uint32_t>(entry, table_size - 1)];
    while (at < limits_.size() && limits_[at] < value) ++at;
    return at;
  }

 private:
  static constexpr std::uint32_t table_size = 2048;
  static std::uint32_t ordered(float value) {
    const auto bits = std::bit_cast<std::uint32_t>(value + 0.F);  // -0 is 0
    return bits >> 31 != 0 ? ~bits : bits | 0x80000000U;
  }

  std::vector<float> limits_;
  std::uint32_t first_;
  int shift_ = 0;
  std::array<std::uint8_t, table_size> begin_{};
};

/// Classes of the values (NaN: none) of a window, which is ranked by itself.
void classify(const std::vector<float>& values, int width, const Window& window, Limits limits_of,
              std::vector<std::uint8_t>& plane) {
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
  const Classifier class_of(limits_of(std::move(sample)));
  each([&](std::size_t i) { plane[i] = class_of(values[i]); });
}

std::vector<std::uint8_t> classes(const std::vector<float>& values, const BearingGrid& grid, Limits limits_of,
                                  int columns = 1, int rows = 1) {
  std::vector<std::uint8_t> plane(grid.pixels(), FeatureSet::none);
  // The first pixel whose middle lies in a part, which is where the vector code draws the line too.
  const auto edge = [](int part, int parts, int extent) {
    return static_cast<int>((2 * static_cast<std::int64_t>(part) * extent + parts - 1) / (2 * parts));
  };
  for (int row = 0; row < rows; ++row)
    for (int column = 0; column < columns; ++column)
      classify(values, grid.width,
               {edge(column, columns, grid.width), edge(row, rows, grid.height), edge(column + 1, columns, grid.width),
                edge(row + 1, rows, grid.height)},
               limits_of, plane);
  return plane;
}

std::vector<std::uint8_t> classes(const std::vector<float>& values, Limits limits_of) {
  std::vector<std::uint8_t> result(values.size());
  if (values.empty()) return result;
  std::vector<float> sample;
  for (std::size_t i = 0; i < values.size(); i += values.size() / 16384 + 1) sample.push_back(values[i]);
  std::ranges::transform(values, result.begin(), Classifier(limits_of(std::move(sample))));
  return result;
}

/// The camera's values at each pixel of the grid; NaN where it has none.
struct Resampled {
  std::vector<float> distance;  // negative inverse distance along the ray, which grows with it
  std::vector<float> depth;     // along the optical axis, up to scale
  std::vector<float> grey;
};

Resampled resample(const FramePair& pair, const DepthMap& depth, const Camera& camera, const BearingGrid& grid,
                   bool with_depth) {
  const bool same = camera.model() == CameraModel::rectified;
  const bool with_grey = pair.image.pixels.size() == depth.inverse_depth.size();
  Resampled result;
  result.distance.assign(grid.pixels(), no_value);
  if (with_depth) result.depth.assign(grid.pixels(), no_value);
  if (with_grey) result.grey.assign(grid.pixels(), no_value);
  for (int v = 0; v < grid.height; ++v)
    for (int u = 0; u < grid.width; ++u) {
      const std::size_t to = static_cast<std::size_t>(v) * grid.width + u;
      std::size_t from = to;
      const Eigen::Vector3d bearing = grid.bearing(u, v);
      if (!same) {
        const auto uv = camera.project(bearing);
        if (!uv) continue;
        // Not lround: it takes -0.5, which the camera sees, to -1.
        from = static_cast<std::size_t>(std::floor(uv->y() + 0.5)) * depth.width +
               static_cast<std::size_t>(std::floor(uv->x() + 0.5));
      }
      if (with_grey) result.grey[to] = pair.image.pixels[from];
      const float inverse = depth.inverse_depth[from];
      if (!(inverse > DepthMap::no_depth) || (!depth.along_ray && bearing.z() <= 0)) continue;
      const auto forward = static_cast<float>(bearing.z());
      result.distance[to] = -(depth.along_ray ? inverse : inverse * forward);
      if (with_depth) result.depth[to] = depth.along_ray ? forward / inverse : 1 / inverse;
    }
  return result;
}

/// Whether some extrinsic within the bounds can bring a point of the camera's frame into view.
class Cull {
 public:
  Cull(const FeaturePlanes& planes, const RigidTransform& T_camera_lidar, const SearchBounds& bounds)
      : T_(T_camera_lidar.cast<float>()),
        wide_(planes.grid.xi != 0),
        max_angle_(static_cast<float>(planes.max_angle_rad)) {
    // The largest angle of Rx Ry Rz with each angle within the bounds, and how far a point can be shifted: by the
    // translation, and because the LiDAR turns about its own origin and not about the camera's.
    const double half = std::min(bounds.rotation_rad, 1.0) / 2;
    turn_ = static_cast<float>(bounds.rotation_rad >= 1
                                   ? std::numbers::pi
                                   : 2 * std::acos(std::pow(std::cos(half), 3) - std::pow(std::sin(half), 3)));
    const double moved = std::sqrt(3.0) * bounds.translation_m + turn_ * T_camera_lidar.translation().norm();
    reach_ = static_cast<float>(std::numbers::pi / 2 * moved);
    still_ = static_cast<float>(std::numbers::pi - max_angle_);
    // A pinhole's view is where all four of these inward normals have p.normal >= 0. A bearing that comes into view by
    // an angle is no further than this angle outside each of them.
    const BearingGrid& grid = planes.grid;
    const auto width = static_cast<float>(grid.width), height = static_cast<float>(grid.height);
    sides_ = {Eigen::Vector3f(grid.fx, 0, grid.cx + 0.5F).normalized(),
              Eigen::Vector3f(-grid.fx, 0, width - 0.5F - grid.cx).normalized(),
              Eigen::Vector3f(0, grid.fy, grid.cy + 0.5F).normalized(),
              Eigen::Vector3f(0, -grid.fy, height - 0.5F - grid.cy).normalized()};
  }

  [[nodiscard]] bool may_be_in_view(const Eigen::Vector3f& p_lidar) const {
    const Eigen::Vector3f p_camera = T_ * p_lidar;
    const float range = p_camera.norm();
    if (!std::isfinite(range)) return false;
    // The angle by which the point can turn in view, times the range: asin x <= pi / 2 x, and a margin for roundoff.
    const float shift = turn_ * range + reach_ + 1e-4F * range;
    if (wide_)  // what is nearer than the camera may be shifted can come from anywhere
      return range <= reach_ || shift >= still_ * range || p_camera.z() >= range * std::cos(max_angle_ + shift / range);
    // sin x <= x, and nothing is further outside than its range.
    return std::ranges::all_of(sides_, [&](const Eigen::Vector3f& side) { return side.dot(p_camera) >= -shift; });
  }

 private:
  Eigen::Isometry3f T_;
  bool wide_;
  float max_angle_, turn_, reach_, still_;
  std::array<Eigen::Vector3f, 4> sides_;
};

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
  for (std::size_t i = 0; i < distance.size(); ++i)
    distance[i] = (Eigen::Vector3f(features.x_m[i], features.y_m[i], features.z_m[i]) - from).norm();
  features.range_rank = classes(distance, equal_population_limits);
}

void take_points(const LidarScan& scan, const RigidTransform& T_camera_lidar, const FeatureSettings& settings,
                 FeatureSet& features) {
  const Cull cull(*features.planes, T_camera_lidar, settings.bounds);
  std::vector<std::size_t> kept;
  for (std::size_t i = 0; i < scan.points.size(); ++i)
    if (cull.may_be_in_view({scan.points[i].x_m, scan.points[i].y_m, scan.points[i].z_m})) kept.push_back(i);
  std::vector<float> range, reflectance;
  for (auto* values : {&features.x_m, &features.y_m, &features.z_m, &range, &reflectance}) values->reserve(kept.size());
  for (const std::size_t i : even_samples_first(kept.size())) {
    const LidarPoint& point = scan.points[kept[i]];
    features.x_m.push_back(point.x_m);
    features.y_m.push_back(point.y_m);
    features.z_m.push_back(point.z_m);
    range.push_back(std::hypot(point.x_m, point.y_m, point.z_m));
    reflectance.push_back(point.reflectance);
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
    const Eigen::Vector3d p = T_camera_lidar * Eigen::Vector3d(features.x_m[i], features.y_m[i], features.z_m[i]);
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
  BearingGrid grid{camera.width(),
                   camera.height(),
                   static_cast<float>(camera.fx()),
                   static_cast<float>(camera.fy()),
                   static_cast<float>(camera.cx()),
                   static_cast<float>(camera.cy()),
                   0};
  if (camera.model() == CameraModel::rectified) return grid;
  // The pinhole or stereographic picture of what the image shows, as fine as the image is on the average. The corners
  // of a round image would claim most of it: a model goes on where the lens does not.
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
  const double scale = std::sqrt(camera.width() * static_cast<double>(camera.height()) / extent.prod());
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
  std::size_t bytes = sizeof *this + sizeof(float) * (x_m.capacity() + y_m.capacity() + z_m.capacity());
  for (const auto* values : {&range_rank, &reflectance_rank, &range_linear, &reflectance_linear})
    bytes += values->capacity();
  if (!planes) return bytes;
  bytes += sizeof *planes;
  bytes += sizeof(std::uint16_t) * planes->packed.capacity();
  for (const auto* values : {&planes->depth_linear, &planes->grey_linear, &planes->grey_rank})
    bytes += values->capacity();
  return bytes;
}

FeatureSet FeatureSet::about(const RigidTransform& T_camera_lidar, const SearchBounds& bounds) const {
  FeatureSet result;
  result.stamp = stamp;
  result.planes = planes;
  const Cull cull(*planes, T_camera_lidar, bounds);
  std::vector<std::size_t> kept;
  for (std::size_t i = 0; i < points(); ++i)
    if (cull.may_be_in_view({x_m[i], y_m[i], z_m[i]})) kept.push_back(i);
  const auto take = [&](const auto& from, auto& to) {
    if (from.empty()) return;
    to.resize(kept.size());
    std::ranges::transform(kept, to.begin(), [&](std::size_t i) { return from[i]; });
  };
  take(x_m, result.x_m);
  take(y_m, result.y_m);
  take(z_m, result.z_m);
  take(reflectance_rank, result.reflectance_rank);
  take(range_linear, result.range_linear);
  take(reflectance_linear, result.reflectance_linear);
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
  const auto pack = [&](const PackedClass& where, const std::vector<std::uint8_t>& plane) {
    for (std::size_t i = 0; i < plane.size(); ++i) planes.packed[i] = where.put(planes.packed[i], plane[i]);
  };
  pack(FeaturePlanes::depth, classes(seen.distance, planes.grid, equal_population_limits));
  pack(FeaturePlanes::tile_depth,
       classes(seen.distance, planes.grid, equal_population_limits, FeatureSet::tile_columns, FeatureSet::tile_rows));
  if (!seen.grey.empty()) {
    std::vector<std::uint8_t> grey = classes(seen.grey, planes.grid, equal_population_limits);
    pack(FeaturePlanes::grey, grey);
    if (settings.baselines) planes.grey_rank = std::move(grey);
  }
  if (settings.baselines) {
    planes.depth_linear = classes(seen.depth, planes.grid, equal_width_limits);
    if (!seen.grey.empty()) planes.grey_linear = classes(seen.grey, planes.grid, equal_width_limits);
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
