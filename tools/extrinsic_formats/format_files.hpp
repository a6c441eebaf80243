#pragma once

#include <functional>

#include "calib/config_node.hpp"
#include "extrinsic_formats/formats.hpp"

namespace calib::formats {

/// Readers and writers of single formats, which `read_frames` and `write_extrinsic` choose from.

Result<Frames> read_tf(const std::vector<TextFile>& files);
Result<Frames> read_kitti(const std::vector<TextFile>& files);
Result<Frames> read_kitti360(const std::vector<TextFile>& files);
Result<Frames> read_autoware(const std::vector<TextFile>& files);
Result<Frames> read_kalibr(const std::vector<TextFile>& files);
Result<Frames> read_urdf(const std::vector<TextFile>& files);
Result<Frames> read_opencalib(const std::vector<TextFile>& files);
Result<Frames> read_nuscenes(const std::vector<TextFile>& files);

/// A pose to write: of `child` in `parent`.
std::string tf_text(const FrameEdge& pose, TfForm form);
std::string autoware_text(const FrameEdge& pose);
std::string urdf_text(const FrameEdge& pose);
std::string kitti_text(const RigidTransform& T_camera0_velodyne);
std::string kitti360_text(const RigidTransform& T_velodyne_camera0);
std::string kalibr_text(const FrameEdge& T_camera_lidar);
std::string opencalib_text(const FrameEdge& T_camera_lidar);
/// Poses of sensors in the ego frame, each with its name.
std::string nuscenes_text(const std::vector<FrameEdge>& poses);

/// `FILE: what`
[[nodiscard]] tl::unexpected<Error> malformed(const TextFile& file, std::string_view what);
/// A bound of transforms that are steps of a chain, as from a map's origin.
inline constexpr double max_step_m = 1e7;

/// As `parse_config_text`, with `calibration_malformed` as the code.
[[nodiscard]] Result<void> parse_yaml(const TextFile& file, const std::function<void(const ConfigNode&)>& read);
/// The number `text`, if it is one and finite.
[[nodiscard]] std::optional<double> parse_number(std::string_view text);
[[nodiscard]] std::vector<std::string> words_of(std::string_view text);
/// Rows of the upper 3x4, or of the whole matrix.
[[nodiscard]] std::vector<std::array<double, 4>> matrix_rows(const RigidTransform& T, int rows);
/// From translation and fixed-axis roll, pitch, yaw (m, rad).
[[nodiscard]] RigidTransform from_xyz_rpy(const Eigen::Vector3d& xyz, const Eigen::Vector3d& rpy);

}  // namespace calib::formats
