#pragma once

#include <atomic>
#include <functional>
#include <optional>

#include "calib/depth.hpp"
#include "config.hpp"
#include "dds/decode.hpp"

namespace calib {

/// Where a pair's depth comes from, by its configuration. The work is done on a thread of its own while the caller
/// waits and, now and then, does what else is due; work that takes too long is cancelled and its estimator thrown away.
class DepthSource final : public DepthEstimator {
 public:
  /// Called about five times a second while depth is waited for; false: give up, calibd ends. Not called any more once
  /// an estimator has gone on for long after it was cancelled, so that the watchdog notices.
  using Breathe = std::function<bool()>;

  /// Makes an estimator in the place of the configured one.
  using Make = std::function<Result<std::unique_ptr<DepthEstimator>>(const PairConfig&)>;

  DepthSource(const PairConfig& pair, Breathe breathe, Make make = {})
      : pair_(pair), breathe_(std::move(breathe)), make_(std::move(make)) {}

  /// What cameras say of themselves, when the right one is known from that alone.
  void hear_left(const CameraInfo& info);
  void hear_right(const CameraInfo& info);
  /// Whether all is known that an estimator is made from.
  [[nodiscard]] bool knows_cameras() const;

  /// The right image's, once its CameraInfo told.
  [[nodiscard]] std::optional<ImageSize> right_size() const;

  /// Makes the estimator, once, and proves it. What fails once fails ever after, but for time that ran out.
  [[nodiscard]] Result<std::string> prepare() override;
  /// Prepares first where that was not done. Fails with `depth_failed`, or `camera_info_missing`.
  [[nodiscard]] Result<DepthMap> estimate(const FramePair& pair) override;

  /// From any thread: whether an estimator is at work.
  [[nodiscard]] bool busy() const { return busy_; }

 private:
  [[nodiscard]] Result<std::unique_ptr<DepthEstimator>> make() const;
  template <typename T>
  [[nodiscard]] Result<T> supervise(const std::function<Result<T>()>& work);

  const PairConfig& pair_;
  Breathe breathe_;
  Make make_;
  std::optional<CameraInfo> left_info_, right_info_;
  std::unique_ptr<DepthEstimator> estimator_;
  std::optional<Error> failure_;
  std::atomic<bool> busy_ = false;
};

/// The right camera as both cameras' CameraInfo tell: by the right one's P when the images are rectified (`left` is
/// `rectified`, and `left_info` is not needed), else by K, D, R and P. Fails with `bad_camera`.
[[nodiscard]] Result<RightCamera> right_camera(const Camera& left, const std::optional<CameraInfo>& left_info,
                                               const CameraInfo& right_info);

/// Of a network's descriptor, which pins the network; empty when it cannot be read.
[[nodiscard]] std::string sha256_of_file(const std::filesystem::path& descriptor);

}  // namespace calib
