#include "calib/depth_agreement.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "calib/cloud_layout.hpp"

namespace calib {
namespace {

/// Places in ascending order; equal values share the mean of theirs.
std::vector<double> ranks(const std::vector<float>& values) {
  std::vector<std::size_t> order(values.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::ranges::sort(order, {}, [&](std::size_t i) { return values[i]; });
  std::vector<double> ranks(values.size());
  for (std::size_t first = 0, end = 0; first < order.size(); first = end) {
    while (end < order.size() && values[order[end]] == values[order[first]]) ++end;
    for (std::size_t i = first; i < end; ++i) ranks[order[i]] = 0.5 * static_cast<double>(first + end - 1);
  }
  return ranks;
}

/// Zero where one side does not vary, and carries no information.
double correlation(const std::vector<double>& a, const std::vector<double>& b) {
  const double mean = 0.5 * static_cast<double>(a.size() - 1);  // of ranks, always
  double ab = 0, aa = 0, bb = 0;
  for (std::size_t i = 0; i < a.size(); ++i) {
    ab += (a[i] - mean) * (b[i] - mean);
    aa += (a[i] - mean) * (a[i] - mean);
    bb += (b[i] - mean) * (b[i] - mean);
  }
  return aa > 0 && bb > 0 ? ab / std::sqrt(aa * bb) : 0;
}

float median(std::vector<float> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::ranges::nth_element(values, middle);
  return *middle;
}

}  // namespace

std::optional<DepthAgreement> depth_agreement(const DepthMap& depth, const Camera& camera,
                                              const RigidTransform& T_camera_lidar, const LidarScan& scan) {
  constexpr std::size_t most = 20'000;
  constexpr std::uint64_t rings_and_columns = 2 * 3 * 5;  // the prime factors that numbers of those have
  if (depth.width != camera.width() || depth.height != camera.height()) return std::nullopt;
  const std::uint64_t stride = sampling_step(scan.points.size(), most, {rings_and_columns});
  std::vector<float> of_points, of_pixels, products;
  for (std::size_t i = 0; i < scan.points.size(); i += stride) {
    const LidarPoint& point = scan.points[i];
    const Eigen::Vector3d p_camera = T_camera_lidar * Eigen::Vector3d(point.x_m, point.y_m, point.z_m);
    const auto uv = camera.project(p_camera);
    if (!uv) continue;
    // A visible point is less than half a pixel outside the centres of the outermost ones.
    const int u = std::clamp(static_cast<int>(std::lround(uv->x())), 0, depth.width - 1);
    const int v = std::clamp(static_cast<int>(std::lround(uv->y())), 0, depth.height - 1);
    const float inverse = depth.inverse_depth[static_cast<std::size_t>(v) * depth.width + u];
    const double distance = depth.along_ray ? p_camera.norm() : p_camera.z();
    if (!(inverse > DepthMap::no_depth) || !(distance > 0)) continue;
    of_points.push_back(static_cast<float>(-distance));
    of_pixels.push_back(inverse);
    products.push_back(static_cast<float>(distance) * inverse);
  }
  if (of_points.size() < min_agreeing_points) return std::nullopt;
  return DepthAgreement{correlation(ranks(of_points), ranks(of_pixels)), median(std::move(products)), of_points.size()};
}

}  // namespace calib
