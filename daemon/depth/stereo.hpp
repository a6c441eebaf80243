#pragma once

#include <optional>
#include <string>

#include "calib/depth_stereo.hpp"
#include "depth/kind.hpp"

namespace calib {

/// Depth from a stereo camera. The right camera is given by the configuration, or by its CameraInfo.
struct StereoDepthConfig {
  std::string right_image;
  /// None: it follows from the CameraInfo of `right_info` and, when the images are not rectified, of
  /// `CameraConfig::info`.
  std::optional<RightCamera> right_camera;
  std::optional<std::string> right_info;
  StereoMatcher matcher = StereoMatcher::sgbm;

  static const DepthSourceKind kind;
  [[nodiscard]] static StereoDepthConfig read(const ConfigNode& node, const CameraConfig& left);
  void add_topics(const Camera& left, PairTopics& topics) const;
  [[nodiscard]] Result<void> pin_files() { return {}; }
  [[nodiscard]] std::string pinned_text() const { return {}; }
  [[nodiscard]] bool has_cameras(const Camera& left, const StereoCameraInfo& infos) const;
  [[nodiscard]] Result<std::unique_ptr<DepthEstimator>> make_estimator(const Camera& left,
                                                                       const StereoCameraInfo& infos) const;
};

}  // namespace calib
