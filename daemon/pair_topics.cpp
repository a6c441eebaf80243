#include "pair_topics.hpp"

#include <algorithm>

namespace calib {
namespace {

constexpr std::uint64_t bytes_per_pixel = 6, bytes_per_point = 64;
constexpr std::uint64_t slack = 4 << 20, least = 16 << 20;

}  // namespace

PairTopics topics_of(const PairConfig& pair) {
  const Camera& camera = pair.camera.camera;
  PairTopics topics{.image = pair.camera.image, .cloud = pair.lidar.cloud, .camera_info = pair.camera.info};
  topics.image_bound = ImageBound::exactly(size_of(camera), "camera.size").with_significant_bits(pair.camera.bits);
  topics.max_points = pair.lidar.max_points;
  add_topics(pair.depth, camera, topics);
  topics.right_bound = topics.right_bound.with_significant_bits(pair.camera.bits);
  if (pair.motion) topics.motion = pair.motion->topic;
  return topics;
}

std::uint32_t max_sample_bytes(const Config& config) {
  std::uint64_t most = least;
  const auto allow_image = [&](const ImageBound& bound) {
    most = std::max(most, bytes_per_pixel * static_cast<std::uint64_t>(bound.max_pixels()) + slack);
  };
  for (const PairConfig& pair : config.pairs) {
    const PairTopics topics = topics_of(pair);
    allow_image(topics.image_bound);
    if (topics.right_image) allow_image(topics.right_bound);
    if (topics.depth) allow_image(topics.depth_bound);
    most = std::max(most, bytes_per_point * topics.max_points + slack);
  }
  return static_cast<std::uint32_t>(most);  // at most 64 Mpx and 4 million points: 390 MB
}

}  // namespace calib
