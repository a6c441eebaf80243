#pragma once

#include <optional>
#include <string>

#include "calib/depth_topic.hpp"
#include "depth/kind.hpp"

namespace calib {

/// Depth that another program publishes: depth images or disparity images.
struct TopicDepthConfig {
  DepthTopic topic;
  /// None: the depth image shows what the camera's image shows.
  std::optional<DepthCamera> camera;

  static const DepthSourceKind kind;
  [[nodiscard]] static TopicDepthConfig read(const ConfigNode& node, const CameraConfig& camera);
  void add_topics(const Camera& image_camera, PairTopics& topics) const;
  [[nodiscard]] Result<void> pin_files() { return {}; }
  [[nodiscard]] std::string pinned_text() const { return {}; }
  [[nodiscard]] bool has_cameras(const Camera&, const StereoCameraInfo&) const { return true; }
  [[nodiscard]] Result<std::unique_ptr<DepthEstimator>> make_estimator(const Camera& image_camera,
                                                                       const StereoCameraInfo& infos) const;
};

}  // namespace calib
