#include "pair_topics.hpp"

#include <algorithm>

namespace calib {
namespace {

constexpr std::uint64_t bytes_per_pixel = 4, bytes_per_point = 64;
constexpr std::uint64_t slack = 4 << 20, least = 16 << 20;

ImageSize size_of(const Camera& camera) { return {camera.width(), camera.height()}; }

}  // namespace

PairTopics topics_of(const PairConfig& pair) {
  const ImageSize left = size_of(pair.camera.camera);
  PairTopics topics{.image = pair.camera.image, .cloud = pair.lidar.cloud, .camera_info = pair.camera.info};
  topics.image_bound = ImageBound::exactly(left, "camera.size");
  topics.max_points = pair.lidar.max_points;
  if (const auto* stereo = std::get_if<StereoDepthConfig>(&pair.depth)) {
    topics.right_image = stereo->right_image;
    topics.right_camera_info = stereo->right_info;
    topics.right_bound = stereo->right_camera
                             ? ImageBound::exactly(size_of(stereo->right_camera->camera),
                                                   "depth.right_camera.size (with baseline_m: camera.size)")
                             : ImageBound::similar(left, "camera.size");
  } else if (const auto* topic = std::get_if<TopicDepthConfig>(&pair.depth)) {
    topics.depth = topic->topic;
    topics.depth_bound = topic->camera ? ImageBound::exactly(size_of(topic->camera->camera), "depth.camera.size")
                                       : ImageBound::scaled(left, "camera.size");
  } else {
    topics.colour = Colour::rgb;
  }
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
  return static_cast<std::uint32_t>(most);  // at most 64 Mpx and 4 million points: 260 MB
}

}  // namespace calib
