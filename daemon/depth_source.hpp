#pragma once

#include <atomic>
#include <functional>
#include <optional>

#include "calib/depth.hpp"
#include "config.hpp"
#include "dds/decode.hpp"

namespace calib {

/// Runs the depth source that a pair is configured with. The estimator works on a thread of its own while the caller
/// waits. If the work takes longer than `PairConfig::depth_timeout`, it is cancelled and the estimator discarded.
class DepthSource final : public DepthEstimator {
 public:
  /// Called by the waiting thread about five times a second. It may feed the watchdog and nothing else; it must not
  /// call back into this object or into its owner. False: cancel the work, calibd is stopping. No longer called when an
  /// estimator has not returned 10 s after it was cancelled, so that the watchdog ends the process.
  using Poll = std::function<bool()>;

  /// Makes an estimator in the place of the configured one.
  using Make = std::function<Result<std::unique_ptr<DepthEstimator>>(const PairConfig&)>;

  /// `pair` outlives this.
  DepthSource(const PairConfig& pair, Poll poll, Make make = {})
      : pair_(pair), poll_(std::move(poll)), make_(std::move(make)) {}

  /// CameraInfo from which the estimator is made, where the configuration does not give the right camera. One that
  /// differs from the last discards the estimator.
  void set_left_camera_info(const CameraInfo& info);
  void set_right_camera_info(const CameraInfo& info);
  /// Whether the cameras are known, so that an estimator can be made.
  [[nodiscard]] bool has_cameras() const;

  /// From the right CameraInfo; none before one was set.
  [[nodiscard]] std::optional<ImageSize> right_image_size() const;

  /// Makes the estimator and prepares it, once. A failure is returned again by each later call, until the CameraInfo
  /// changes; a timeout is not. Does nothing while `has_cameras` is false. Fails with `depth_failed`.
  [[nodiscard]] Result<std::string> prepare() override;
  /// Prepares the estimator first, if that was not done. Fails with `depth_failed` or `camera_info_missing`.
  [[nodiscard]] Result<DepthMap> estimate(const FramePair& pair) override;

  /// From any thread: whether an estimator is working.
  [[nodiscard]] bool busy() const { return busy_; }

 private:
  void set(std::optional<CameraInfo>& known, const CameraInfo& info);
  template <typename T>
  [[nodiscard]] Result<T> supervise(const std::function<Result<T>()>& work);

  const PairConfig& pair_;
  Poll poll_;
  Make make_;
  StereoCameraInfo infos_;
  std::unique_ptr<DepthEstimator> estimator_;
  std::optional<Error> failure_;
  std::atomic<bool> busy_ = false;
};

}  // namespace calib
