#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "calib/camera.hpp"
#include "calib/frame.hpp"
#include "calib/geometry.hpp"
#include "calib/result.hpp"

namespace calib {

/// A synchronised and rectified KITTI raw drive: left colour camera (image_02) as the camera of the pair,
/// image_03 as its right image, and the Velodyne's scans. Calibration files lie in the folder above the drive
/// (`<date>/calib_cam_to_cam.txt`, `<date>/calib_velo_to_cam.txt`).
///
/// Geiger et al., "Vision meets Robotics: The KITTI Dataset", IJRR 2013.
class KittiRawDrive {
 public:
  /// `drive` is the folder `<date>/<drive>`. Fails with `drive_not_found`, `calibration_missing`,
  /// `calibration_malformed`, or `frame_mismatch` when the two cameras and the LiDAR do not have the same
  /// frames.
  [[nodiscard]] static Result<KittiRawDrive> open(const std::filesystem::path& drive);

  [[nodiscard]] std::size_t size() const { return frame_names_.size(); }

  /// Frame `index` of `size()`; both stamps are `index` x 100 ms, the cameras' period.
  /// Fails with `frame_out_of_range`, `image_unreadable` (or not of the calibration's size) or
  /// `cloud_unreadable` (missing, not whole points, or no point at all). Points that are not finite or beyond
  /// 500 m are left out.
  [[nodiscard]] Result<FramePair> frame(std::size_t index) const;

  /// Rectified.
  [[nodiscard]] const Camera& camera() const { return camera_; }
  [[nodiscard]] double baseline_m() const { return baseline_m_; }
  /// Of camera 2 itself: the translation that KITTI keeps in the fourth column of P_rect_02 is part of it.
  [[nodiscard]] const RigidTransform& T_camera_lidar() const { return T_camera_lidar_; }

 private:
  KittiRawDrive(std::filesystem::path drive, Camera camera)
      : drive_(std::move(drive)), camera_(std::move(camera)) {}

  std::filesystem::path drive_;
  std::vector<std::string> frame_names_;  // file names without extension, sorted
  Camera camera_;
  double baseline_m_ = 0;
  RigidTransform T_camera_lidar_ = RigidTransform::Identity();
};

/// Writes a drive that `KittiRawDrive` (and every other reader of KITTI raw) reads: the calibration files at
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
