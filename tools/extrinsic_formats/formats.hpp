#pragma once

#include <array>
#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "extrinsic_formats/frame_graph.hpp"

namespace calib::formats {

/// Others' files of extrinsics. What each one's frames, directions and axes mean stands in README.md beside this.
enum class Format { tf, kitti, autoware, kalibr, urdf, opencalib, nuscenes, kitti360 };

/// optical: x right, y down, z forward. body: x forward, y left, z up (REP 103).
enum class CameraAxes { optical, body };

struct FormatFacts {
  Format format;
  std::string_view name;
  /// Axes of its camera frames, unless a frame's name holds `optical`.
  CameraAxes axes;
  /// Names that a written file has for the two sensors where none are given.
  std::string_view camera, lidar;
  /// Files are written as the pose of a child in a parent that may be any frame.
  bool is_tree;
  std::uint64_t max_bytes;
};

/// One for each format, in the order of the enumerators.
inline constexpr std::array all_formats{
    FormatFacts{Format::tf, "tf", CameraAxes::optical, "camera_optical_frame", "lidar", true, 1 << 20},
    FormatFacts{Format::kitti, "kitti", CameraAxes::optical, "camera0", "velodyne", false, 1 << 20},
    FormatFacts{Format::autoware, "autoware", CameraAxes::body, "camera0/camera_link", "lidar", true, 1 << 20},
    FormatFacts{Format::kalibr, "kalibr", CameraAxes::optical, "cam0", "lidar", false, 1 << 20},
    FormatFacts{Format::urdf, "urdf", CameraAxes::optical, "camera_optical_frame", "lidar", true, 4 << 20},
    FormatFacts{Format::opencalib, "opencalib", CameraAxes::optical, "camera", "lidar", false, 1 << 20},
    FormatFacts{Format::nuscenes, "nuscenes", CameraAxes::optical, "CAM_FRONT", "LIDAR_TOP", true, 32 << 20},
    FormatFacts{Format::kitti360, "kitti360", CameraAxes::optical, "camera0", "velodyne", false, 1 << 20},
};
[[nodiscard]] constexpr const FormatFacts& facts_of(Format format) {
  return all_formats[static_cast<std::size_t>(format)];
}

struct TextFile {
  std::string name;
  std::string text;
};

/// What files of one format say.
struct Frames {
  std::vector<FrameEdge> edges;
  /// Where only one frame can be meant.
  std::optional<std::string> camera, lidar;
  /// What a person has to know who asks for a frame that is not there.
  std::string remark;
};

/// Fails with `calibration_malformed` and `FILE[:LINE]: KEY: what is wrong` for the first thing that is.
[[nodiscard]] Result<Frames> read_frames(Format format, const std::vector<TextFile>& files);

/// How /tf_static is written.
enum class TfForm { arguments, yaml, json };

/// The extrinsic to write. Names have 1 .. 128 of the characters A-Z a-z 0-9 _ / . - (`is_frame_name`).
struct Extrinsic {
  /// With the axes of the format's camera frame.
  RigidTransform T_camera_lidar;
  std::string camera, lidar;
  /// In which the camera's pose is written, where the format is a tree: the LiDAR; the camera, for the LiDAR's pose in
  /// it; or a frame of `known`.
  std::string parent;
  /// Other transforms of the vehicle.
  FrameGraph known;
  TfForm tf_form = TfForm::arguments;
};

[[nodiscard]] bool is_frame_name(std::string_view name);
/// Fails with `not_found` when `known` does not lead to the frames that the format is written in.
[[nodiscard]] Result<std::string> write_extrinsic(Format format, const Extrinsic& extrinsic);

/// The shortest decimal number that is read as the same double, also by YAML 1.1.
[[nodiscard]] std::string number_text(double value);

/// Turns the axes of a camera's body frame into those of its optical frame: roll -90, pitch 0, yaw -90 degrees
/// inverted.
[[nodiscard]] RigidTransform T_optical_body();

}  // namespace calib::formats
