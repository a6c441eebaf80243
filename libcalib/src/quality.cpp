#include "calib/quality.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>

namespace calib {
namespace {

constexpr int thumbnail_width = 48, thumbnail_height = 24;

/// Pixels at the sensor's limits carry no information when everything within this reach is at the same limit.
constexpr int flat_reach = 2;

/// 1 for white, -1 for black, 0 for what holds a measurement.
int clipped_as(std::uint8_t grey) { return grey >= 254 ? 1 : grey <= 1 ? -1 : 0; }

double mean_absolute_difference(const SceneThumbnail& a, const SceneThumbnail& b) {
  double sum = 0;
  for (std::size_t i = 0; i < a.grey.size(); ++i) sum += std::abs(a.grey[i] - b.grey[i]);
  return sum / static_cast<double>(a.grey.size());
}

/// All refusals by a number read alike.
Result<void> refuse(ErrorCode code, const char* what, double value, double limit) {
  return fail(code, fmt::format("{} is {:.2f}, the limit is {:.2f}", what, value, limit));
}

}  // namespace

SceneThumbnail thumbnail(const Image& image) {
  SceneThumbnail result;
  result.grey.reserve(thumbnail_width * thumbnail_height);
  for (int j = 0; j < thumbnail_height; ++j)
    for (int i = 0; i < thumbnail_width; ++i) {
      const int u0 = i * image.width / thumbnail_width, u1 = (i + 1) * image.width / thumbnail_width;
      const int v0 = j * image.height / thumbnail_height, v1 = (j + 1) * image.height / thumbnail_height;
      int sum = 0, count = 0;
      for (int v = v0; v < v1; v += 2)
        for (int u = u0; u < u1; u += 2, ++count) sum += image.pixels[static_cast<std::size_t>(v) * image.width + u];
      result.grey.push_back(static_cast<std::uint8_t>(count > 0 ? sum / count : 0));
    }
  return result;
}

double scene_change(const SceneThumbnail& a, const SceneThumbnail& b) {
  const auto n = static_cast<double>(a.grey.size());
  double sum_a = 0, sum_b = 0, aa = 0, bb = 0, ab = 0;
  for (std::size_t i = 0; i < a.grey.size(); ++i) {
    const double x = a.grey[i], y = b.grey[i];
    sum_a += x, sum_b += y, aa += x * x, bb += y * y, ab += x * y;
  }
  const double spread = std::sqrt((n * aa - sum_a * sum_a) * (n * bb - sum_b * sum_b));
  // An image without contrast shows no scene that another could be compared with.
  return spread > 0 ? std::max(0.0, 1 - (n * ab - sum_a * sum_b) / spread) : 0;
}

Result<void> check_pair(const FramePair& pair, const Camera& camera, const SceneThumbnail* last,
                        const QualityLimits& limits) {
  const Image& image = pair.image;
  if (image.width != camera.width() || image.height != camera.height())
    return fail(ErrorCode::image_size_mismatch,
                fmt::format("the image is {} x {}, the configured camera {} x {}", image.width, image.height,
                            camera.width(), camera.height()));
  if (pair.turn_rate_rad_s) {
    const double apart_s = std::abs(std::chrono::duration<double>(pair.time_difference()).count());
    if (const double turn_rad = apart_s * *pair.turn_rate_rad_s; turn_rad > limits.max_turn_rad)
      return refuse(ErrorCode::motion, "turn between image and point cloud in degrees", turn_rad / radians_per_degree,
                    limits.max_turn_rad / radians_per_degree);
  }
  constexpr int step = 4;
  double grey = 0, saturated = 0, texture = 0;
  std::size_t count = 0;
  for (int v = 0; v < image.height; v += step) {
    const std::uint8_t* row = image.pixels.data() + static_cast<std::ptrdiff_t>(v) * image.width;
    for (int u = 0; u + step < image.width; u += step, ++count) {
      grey += row[u];
      saturated += row[u] >= 250;
      texture += std::abs(row[u] - row[u + step]);
    }
  }
  const auto n = static_cast<double>(count);
  if (grey / n < limits.min_mean_grey) return refuse(ErrorCode::dark, "mean grey", grey / n, limits.min_mean_grey);
  if (saturated / n > limits.max_saturated_share)
    return refuse(ErrorCode::saturated, "share of saturated pixels", saturated / n, limits.max_saturated_share);
  if (texture / n < limits.min_texture)
    return refuse(ErrorCode::low_texture, "texture", texture / n, limits.min_texture);
  if (last != nullptr)
    if (const double change = mean_absolute_difference(thumbnail(image), *last); change < limits.min_scene_change)
      return refuse(ErrorCode::standing_still, "grey difference to the last evaluated image", change,
                    limits.min_scene_change);
  if (pair.scan.points.size() < static_cast<std::size_t>(limits.min_points))
    return fail(ErrorCode::low_overlap, fmt::format("the scan has only {} points", pair.scan.points.size()));
  return {};
}

Result<void> mask_depth(const Image& image, const DepthRange& range, DepthMap& depth) {
  if (image.width != depth.width || image.height != depth.height)
    return fail(ErrorCode::image_size_mismatch, fmt::format("depth is {} x {}, its image {} x {}", depth.width,
                                                            depth.height, image.width, image.height));
  const auto far = static_cast<float>(range.max_m > 0 ? 1 / range.max_m : 0);
  const auto near = range.min_m > 0 ? static_cast<float>(1 / range.min_m) : std::numeric_limits<float>::infinity();
  for (float& inverse : depth.inverse_depth)
    if (!(inverse >= far && inverse <= near)) inverse = DepthMap::no_depth;

  const auto flat = [&](int u, int v) {
    const auto clipped = [&](int x, int y) {
      return clipped_as(image.pixels[static_cast<std::size_t>(y) * image.width + x]);
    };
    const int kind = clipped(u, v);
    if (kind == 0) return false;
    for (int y = std::max(v - flat_reach, 0); y <= std::min(v + flat_reach, image.height - 1); ++y)
      for (int x = std::max(u - flat_reach, 0); x <= std::min(u + flat_reach, image.width - 1); ++x)
        if (clipped(x, y) != kind) return false;
    return true;
  };
  for (int v = 0; v < image.height; ++v)
    for (int u = 0; u < image.width; ++u)
      if (flat(u, v)) depth.inverse_depth[static_cast<std::size_t>(v) * depth.width + u] = DepthMap::no_depth;
  return {};
}

Result<void> check_depth(const DepthMap& depth, const QualityLimits& limits) {
  if (const double share = depth.valid_share(); share < limits.min_valid_depth)
    return refuse(ErrorCode::few_valid_depth, "share of pixels with depth", share, limits.min_valid_depth);
  return {};
}

}  // namespace calib
