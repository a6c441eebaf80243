#include "calib/features.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <string>

namespace calib {
namespace {

/// Upper limits of equally populated classes of `values` (which it sorts): class i holds values <= limits[i].
/// Sorting a sample of at most 64 k values is enough for 252 classes, and much quicker.
std::vector<float> equal_population_limits(std::vector<float> values) {
  std::ranges::sort(values);
  std::vector<float> limits(FeatureSet::ranks - 1);
  for (std::size_t i = 0; i < limits.size(); ++i)
    limits[i] = values[(i + 1) * values.size() / FeatureSet::ranks];
  return limits;
}

std::uint8_t rank_of(float value, const std::vector<float>& limits) {
  return static_cast<std::uint8_t>(std::ranges::lower_bound(limits, value) - limits.begin());
}

/// From depth along the optical axis to distance along the ray, which is what the LiDAR's range compares to: without this,
/// the relation between the two would change from the middle of the image to its edges. The values are the negative
/// inverse distance, so that they grow with it; none where there is no depth.
std::vector<float> ray_distance(const DepthMap& depth, const Camera& camera) {
  std::vector<float> distance(depth.inverse_depth.size());
  for (int v = 0; v < depth.height; ++v) {
    const double y = (v - camera.cy()) / camera.fy();
    for (int u = 0; u < depth.width; ++u) {
      const double x = (u - camera.cx()) / camera.fx();
      const std::size_t i = static_cast<std::size_t>(v) * depth.width + u;
      distance[i] = -depth.inverse_depth[i] / static_cast<float>(std::sqrt(1 + x * x + y * y));
    }
  }
  return distance;
}

std::vector<std::uint8_t> rank_depth(const DepthMap& depth, const Camera& camera) {
  const std::vector<float> distance = ray_distance(depth, camera);
  const auto known = [&](std::size_t i) { return depth.inverse_depth[i] > DepthMap::no_depth; };
  std::vector<float> sample;
  const std::size_t stride = distance.size() / 65536 + 1;
  for (std::size_t i = 0; i < distance.size(); i += stride)
    if (known(i)) sample.push_back(distance[i]);
  std::vector<std::uint8_t> ranks(distance.size(), FeatureSet::no_depth);
  if (sample.empty()) return ranks;
  const std::vector<float> limits = equal_population_limits(std::move(sample));
  for (std::size_t i = 0; i < ranks.size(); ++i)
    if (known(i)) ranks[i] = rank_of(distance[i], limits);
  return ranks;
}

/// Depth as the pinhole camera with the same intrinsics sees it, by nearest neighbour.
DepthMap rectify(const DepthMap& depth, const Camera& camera) {
  DepthMap out{depth.width, depth.height, std::vector<float>(depth.inverse_depth.size(), DepthMap::no_depth)};
  for (int v = 0; v < out.height; ++v)
    for (int u = 0; u < out.width; ++u) {
      const Eigen::Vector3d bearing((u - camera.cx()) / camera.fx(), (v - camera.cy()) / camera.fy(), 1);
      if (const auto uv = camera.project(bearing)) {
        const auto from_u = std::lround(uv->x()), from_v = std::lround(uv->y());
        out.inverse_depth[static_cast<std::size_t>(v) * out.width + u] =
            depth.inverse_depth[from_v * depth.width + from_u];
      }
    }
  return out;
}

/// Points that some extrinsic within the bounds can bring into view.
void keep_points_near_frustum(const LidarScan& scan, const RigidTransform& T_camera_lidar, const SearchBounds& bounds,
                              FeatureSet& features) {
  // The largest angle of Rx Ry Rz with each angle within the bounds, and how far a point can be shifted: by the
  // translation, and because the LiDAR turns about its own origin and not about the camera's.
  const double half = std::min(bounds.rotation_rad, 1.0) / 2;
  const double turn = 2 * std::acos(std::pow(std::cos(half), 3) - std::pow(std::sin(half), 3));
  const double reach = std::sqrt(3.0) * bounds.translation_m + turn * T_camera_lidar.translation().norm();
  // The view is where all four of these inward normals have p.normal >= 0. A bearing that comes into view by an angle is
  // no further than this angle outside each of them.
  const auto width = static_cast<float>(features.width), height = static_cast<float>(features.height);
  const Eigen::Vector3f sides[] = {
      Eigen::Vector3f(features.fx, 0, features.cx + 0.5F).normalized(),
      Eigen::Vector3f(-features.fx, 0, width - 0.5F - features.cx).normalized(),
      Eigen::Vector3f(0, features.fy, features.cy + 0.5F).normalized(),
      Eigen::Vector3f(0, -features.fy, height - 0.5F - features.cy).normalized()};
  const Eigen::Isometry3f T = T_camera_lidar.cast<float>();
  for (const LidarPoint& point : scan.points) {
    const Eigen::Vector3f p = T * Eigen::Vector3f(point.x_m, point.y_m, point.z_m);
    const double range = p.norm();
    const double angle = turn + std::asin(std::min(1.0, reach / range)) + 1e-4;  // a margin for roundoff
    const double least = angle < 1.5 ? -std::sin(angle) * range : -range - 1;
    const auto may_be_inside = [&](const Eigen::Vector3f& side) { return side.dot(p) >= least; };
    if (!std::ranges::all_of(sides, may_be_inside)) continue;
    features.x_m.push_back(point.x_m);
    features.y_m.push_back(point.y_m);
    features.z_m.push_back(point.z_m);
  }
}

void rank_ranges(FeatureSet& features) {
  const std::size_t count = features.x_m.size();
  if (count == 0) return;
  std::vector<float> range(count);
  for (std::size_t i = 0; i < count; ++i)
    range[i] = std::sqrt(features.x_m[i] * features.x_m[i] + features.y_m[i] * features.y_m[i] +
                         features.z_m[i] * features.z_m[i]);
  const std::vector<float> limits = equal_population_limits(range);
  features.range_rank.resize(count);
  for (std::size_t i = 0; i < count; ++i) features.range_rank[i] = rank_of(range[i], limits);
}

}  // namespace

std::size_t FeatureSet::memory_bytes() const {
  return sizeof *this + depth_rank.capacity() + range_rank.capacity() +
         sizeof(float) * (x_m.capacity() + y_m.capacity() + z_m.capacity());
}

Result<FeatureSet> make_features(const DepthMap& depth, const LidarScan& scan, const Camera& camera,
                                 const RigidTransform& T_camera_lidar, const SearchBounds& bounds, int min_points) {
  if (depth.width != camera.width() || depth.height != camera.height() ||
      depth.inverse_depth.size() != static_cast<std::size_t>(depth.width) * depth.height)
    return fail("depth_failed", "the depth map does not have the camera's size");
  FeatureSet features;
  features.stamp = scan.stamp;
  features.width = camera.width();
  features.height = camera.height();
  features.fx = static_cast<float>(camera.fx());
  features.fy = static_cast<float>(camera.fy());
  features.cx = static_cast<float>(camera.cx());
  features.cy = static_cast<float>(camera.cy());
  features.depth_rank =
      rank_depth(camera.model() == CameraModel::rectified ? depth : rectify(depth, camera), camera);

  keep_points_near_frustum(scan, T_camera_lidar, bounds, features);
  rank_ranges(features);
  for (auto* coordinates : {&features.x_m, &features.y_m, &features.z_m}) coordinates->shrink_to_fit();

  int on_depth = 0;
  for (std::size_t i = 0; i < features.x_m.size(); ++i) {
    const Eigen::Vector3d p = T_camera_lidar * Eigen::Vector3d(features.x_m[i], features.y_m[i], features.z_m[i]);
    if (p.z() <= 0) continue;
    const double u = camera.fx() * p.x() / p.z() + camera.cx(), v = camera.fy() * p.y() / p.z() + camera.cy();
    if (u < 0 || v < 0 || u > features.width - 1 || v > features.height - 1) continue;
    const auto pixel = std::lround(v) * features.width + std::lround(u);
    on_depth += features.depth_rank[pixel] != FeatureSet::no_depth;
  }
  if (on_depth < min_points)
    return fail("low_overlap", std::to_string(on_depth) + " LiDAR points land on pixels with depth, at least " +
                                   std::to_string(min_points) +
                                   " are needed; do camera and LiDAR look the same way, and is T_camera_lidar right?");
  return features;
}

}  // namespace calib
