#pragma once

#include <memory>
#include <string>
#include <vector>

#include "calib/camera.hpp"
#include "calib/frame.hpp"

namespace calib {

/// Inverse depth of every pixel of an image, up to an unknown monotone scale (larger is nearer); 1/m when it is metric.
/// Row-major, `inverse_depth.size() == width * height`; a pixel without depth holds `no_depth`, valid ones are > 0.
struct DepthMap {
  static constexpr float no_depth = 0;
  int width = 0;
  int height = 0;
  std::vector<float> inverse_depth;
  /// The inverse of the distance along the ray, as wide lenses need it, instead of that along the optical axis.
  bool along_ray = false;

  /// Share of the pixels that have depth, 0 .. 1.
  [[nodiscard]] double valid_share() const;
};

/// Where depth comes from. An estimator may keep scratch memory between calls; it is used by one thread.
class DepthEstimator {
 public:
  virtual ~DepthEstimator() = default;
  /// Depth for `pair.image`, of the same size. Fails with `depth_failed`.
  [[nodiscard]] virtual Result<DepthMap> estimate(const FramePair& pair) = 0;
  /// Once, before the first pair: loads and proves what can be proven, such as a network's pinned hash and golden pair.
  /// Returns a remark for the log, empty when there is none. Fails with `depth_failed`.
  [[nodiscard]] virtual Result<std::string> prepare() { return std::string(); }
  /// From any thread, to shut down: ends an `estimate` or `prepare` that is going on, as far as the source can be
  /// interrupted; that one and all later ones fail with `depth_failed`.
  virtual void cancel() {}
};

}  // namespace calib
