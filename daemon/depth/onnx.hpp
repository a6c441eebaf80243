#pragma once

#include <filesystem>
#include <string>

#include "calib/depth_onnx.hpp"
#include "depth/kind.hpp"

namespace calib {

/// Depth from one image, by a network that ONNX Runtime runs.
struct OnnxDepthConfig {
  std::filesystem::path model;  // its descriptor
  /// SHA-256 of the descriptor when `pin_files` was called, lower-case hex. The descriptor in turn holds that of the
  /// network. Empty: not called, or the descriptor could not be read. A descriptor of another digest is refused.
  std::string descriptor_sha256 = {};
  OnnxSettings settings;

  static const DepthSourceKind kind;
  [[nodiscard]] static OnnxDepthConfig read(const ConfigNode& node, const CameraConfig& camera);
  void add_topics(const Camera&, PairTopics&) const {}
  [[nodiscard]] Result<void> pin_files();
  [[nodiscard]] std::string pinned_text() const { return "model:" + descriptor_sha256 + '\n'; }
  [[nodiscard]] bool has_cameras(const Camera&, const StereoCameraInfo&) const { return true; }
  [[nodiscard]] Result<std::unique_ptr<DepthEstimator>> make_estimator(const Camera& camera,
                                                                       const StereoCameraInfo& infos) const;
};

}  // namespace calib
