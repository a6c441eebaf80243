#pragma once

#include <filesystem>

#include "calib/camera.hpp"
#include "calib/frame.hpp"
#include "calib/geometry.hpp"
#include "calib/result.hpp"

namespace calib {

/// Writes a drive that `open_kitti_raw` (and every other reader of KITTI raw) reads: the calibration files at
/// `create`, then one frame per `append`. Fails with `write_failed`.
class KittiRawWriter {
 public:
  /// `drive` is `<root>/<date>/<drive>`; folders are made, files of the same name replaced.
  [[nodiscard]] static Result<KittiRawWriter> create(const std::filesystem::path& drive, const Camera& camera,
                                                     double baseline_m, const RigidTransform& T_camera_lidar);
  /// `pair` must have a right image.
  [[nodiscard]] Result<void> append(const FramePair& pair);

 private:
  explicit KittiRawWriter(std::filesystem::path drive) : drive_(std::move(drive)) {}
  std::filesystem::path drive_;
  std::size_t count_ = 0;
};

}  // namespace calib
