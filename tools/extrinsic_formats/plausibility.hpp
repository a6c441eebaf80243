#pragma once

#include <optional>
#include <string>

#include "extrinsic_formats/formats.hpp"

namespace calib::formats {

/// How the transform between two frames of a file becomes T_camera_lidar.
struct Reading {
  bool inverse = false;
  CameraAxes axes = CameraAxes::optical;  // of the file's camera frame
  friend bool operator==(const Reading&, const Reading&) = default;
};

/// T_camera_lidar with optical axes, of `T`, which a file states as the transform from its LiDAR frame to its camera
/// frame.
[[nodiscard]] RigidTransform read_as(const RigidTransform& T, const Reading& reading);

struct Doubt {
  std::string words;  // "it looks like its inverse"
  std::optional<Reading> better;
};

/// Why `read_as(T, reading)` cannot well be an extrinsic. Judged by `examine_extrinsic` with a camera of 90 degrees and
/// a scan all around, at 20 m: whether the LiDAR's z axis points up in the image, or else another reading sets it
/// upright. A camera that is mounted on its side is not doubted, as long as no other reading fits.
[[nodiscard]] std::optional<Doubt> doubt_about(const RigidTransform& T, const Reading& reading);

}  // namespace calib::formats
