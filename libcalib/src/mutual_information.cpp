#include "calib/mutual_information.hpp"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <cstdint>
#include <vector>

namespace calib {
namespace {

constexpr int max_bins = 64;
using Counts = std::array<std::uint32_t, max_bins * max_bins>;

/// x log x summed over `values`; with the total n: n log n - sum = n H.
template <typename Values>
double sum_x_log_x(const Values& values, int count) {
  double sum = 0;
  for (int i = 0; i < count; ++i)
    if (values[i] > 0) sum += static_cast<double>(values[i]) * std::log(static_cast<double>(values[i]));
  return sum;
}

/// Joint counts of (range class, depth class); returns the number of points counted.
std::size_t fill(const FeatureSet& features, const RigidTransform& T_camera_lidar, const ObjectiveOptions& options,
                 Counts& counts) {
  // The intrinsics go into the transform, so that a point costs nine multiplications and one division.
  Eigen::Matrix3d K = Eigen::Matrix3d::Identity();
  K(0, 0) = features.fx;
  K(1, 1) = features.fy;
  K(0, 2) = features.cx + 0.5;  // truncation then rounds to the nearest pixel
  K(1, 2) = features.cy + 0.5;
  const Eigen::Matrix<float, 3, 4> P = (K * T_camera_lidar.matrix().topRows<3>()).cast<float>();
  const auto width = static_cast<float>(features.width), height = static_cast<float>(features.height);
  const int bins = options.bins;

  std::array<std::uint16_t, 256> bin_of_rank;  // of a depth rank; invalid depth goes to a class of its own
  for (int rank = 0; rank < FeatureSet::ranks; ++rank)
    bin_of_rank[rank] = static_cast<std::uint16_t>(rank * bins / FeatureSet::ranks);

  std::size_t points = 0;
  for (std::size_t i = 0; i < features.x_m.size(); i += options.stride) {
    const float x = features.x_m[i], y = features.y_m[i], z = features.z_m[i];
    const float depth = P(2, 0) * x + P(2, 1) * y + P(2, 2) * z + P(2, 3);
    if (!(depth > 0.1F)) continue;
    const float inverse = 1.0F / depth;
    const float u = (P(0, 0) * x + P(0, 1) * y + P(0, 2) * z + P(0, 3)) * inverse;
    const float v = (P(1, 0) * x + P(1, 1) * y + P(1, 2) * z + P(1, 3)) * inverse;
    if (!(u >= 0 && u < width && v >= 0 && v < height)) continue;
    const std::uint8_t rank = features.depth_rank[static_cast<std::size_t>(v) * features.width + static_cast<int>(u)];
    if (rank == FeatureSet::no_depth) continue;
    ++counts[bin_of_rank[features.range_rank[i]] * max_bins + bin_of_rank[rank]];
    ++points;
  }
  return points;
}

/// [1 2 1] in both directions; weight that would leave the table stays at its edge, so the total is 16 times the points.
void smooth(const Counts& counts, int bins, Counts& smoothed) {
  static thread_local Counts across;
  for (int i = 0; i < bins; ++i) {
    const std::uint32_t* row = &counts[i * max_bins];
    for (int j = 0; j < bins; ++j)
      across[i * max_bins + j] = row[std::max(j - 1, 0)] + 2 * row[j] + row[std::min(j + 1, bins - 1)];
  }
  for (int i = 0; i < bins; ++i)
    for (int j = 0; j < bins; ++j)
      smoothed[i * max_bins + j] = across[std::max(i - 1, 0) * max_bins + j] + 2 * across[i * max_bins + j] +
                                   across[std::min(i + 1, bins - 1) * max_bins + j];
}

}  // namespace

Score score(const FeatureSet& features, const RigidTransform& T_camera_lidar, const ObjectiveOptions& options) {
  assert(options.bins >= 2 && options.bins <= max_bins && options.stride >= 1);
  Counts counts{};
  const std::size_t points = fill(features, T_camera_lidar, options, counts);
  if (points < min_scored_points) return {1, points};

  static thread_local Counts smoothed;
  smooth(counts, options.bins, smoothed);
  std::array<std::uint64_t, max_bins> range_counts{}, depth_counts{};
  double joint = 0;
  for (int i = 0; i < options.bins; ++i) {
    const std::uint32_t* row = &smoothed[i * max_bins];
    joint += sum_x_log_x(row, options.bins);
    for (int j = 0; j < options.bins; ++j) {
      range_counts[i] += row[j];
      depth_counts[j] += row[j];
    }
  }
  const double n = 16.0 * static_cast<double>(points);
  const double n_log_n = n * std::log(n);
  const double joint_entropy = n_log_n - joint;  // times n, as the two below
  if (joint_entropy <= 0) return {1, points};    // one single class holds all points
  const double range_entropy = n_log_n - sum_x_log_x(range_counts, options.bins);
  const double depth_entropy = n_log_n - sum_x_log_x(depth_counts, options.bins);
  return {(range_entropy + depth_entropy) / joint_entropy, points};
}

Score mean_score(Frames frames, const RigidTransform& T_camera_lidar,
                 const ObjectiveOptions& options) {
  Score mean;
  for (const FeatureSet* frame : frames) {
    const Score one = score(*frame, T_camera_lidar, options);
    mean.value += one.value;
    mean.points += one.points;
  }
  if (!frames.empty()) mean.value /= static_cast<double>(frames.size());
  return mean;
}

}  // namespace calib
