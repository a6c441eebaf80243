#include "extrinsic_formats/formats.hpp"

#include <algorithm>
#include <charconv>
#include <cmath>

#include "extrinsic_formats/format_files.hpp"

namespace calib::formats {
namespace {

/// The pose that a tree gets: of the camera in the parent, or of the LiDAR where the camera is the parent.
Result<FrameEdge> pose_in_parent(const Extrinsic& extrinsic) {
  if (extrinsic.parent == extrinsic.camera)
    return FrameEdge{extrinsic.camera, extrinsic.lidar, extrinsic.T_camera_lidar, ""};
  // Not by way of the camera, whose old pose is the one to replace.
  const auto T_parent_lidar = extrinsic.known.transform(extrinsic.parent, extrinsic.lidar, extrinsic.camera);
  if (!T_parent_lidar) return propagate(T_parent_lidar);
  return FrameEdge{extrinsic.parent, extrinsic.camera, *T_parent_lidar * extrinsic.T_camera_lidar.inverse(), ""};
}

/// In the one camera frame that KITTI's files are in.
Result<RigidTransform> T_camera0_lidar(const Extrinsic& extrinsic) {
  const auto T_camera0_camera = extrinsic.known.transform("camera0", extrinsic.camera);
  if (!T_camera0_camera) return propagate(T_camera0_camera);
  return *T_camera0_camera * extrinsic.T_camera_lidar;
}

/// Both sensors in the ego frame, which is the parent.
Result<std::string> write_nuscenes(const Extrinsic& extrinsic) {
  auto T_ego_lidar = extrinsic.parent == extrinsic.camera
                         ? extrinsic.T_camera_lidar
                         : extrinsic.known.transform(extrinsic.parent, extrinsic.lidar, extrinsic.camera);
  if (!T_ego_lidar) return propagate(T_ego_lidar);
  return nuscenes_text({{extrinsic.parent, extrinsic.lidar, *T_ego_lidar, ""},
                        {extrinsic.parent, extrinsic.camera, *T_ego_lidar * extrinsic.T_camera_lidar.inverse(), ""}});
}

}  // namespace

Result<Frames> read_frames(Format format, const std::vector<TextFile>& files) {
  switch (format) {
    case Format::tf:
      return read_tf(files);
    case Format::kitti:
      return read_kitti(files);
    case Format::autoware:
      return read_autoware(files);
    case Format::kalibr:
      return read_kalibr(files);
    case Format::urdf:
      return read_urdf(files);
    case Format::opencalib:
      return read_opencalib(files);
    case Format::nuscenes:
      return read_nuscenes(files);
    case Format::kitti360:
      return read_kitti360(files);
  }
  return fail(ErrorCode::bad_request, "unknown format");
}

Result<std::string> write_extrinsic(Format format, const Extrinsic& extrinsic) {
  const FrameEdge direct{extrinsic.camera, extrinsic.lidar, extrinsic.T_camera_lidar, ""};
  if (format == Format::kalibr) return kalibr_text(direct);
  if (format == Format::opencalib) return opencalib_text(direct);
  if (format == Format::nuscenes) return write_nuscenes(extrinsic);
  if (format == Format::kitti || format == Format::kitti360) {
    const auto T = T_camera0_lidar(extrinsic);
    if (!T) return propagate(T);
    return format == Format::kitti ? kitti_text(*T) : kitti360_text(T->inverse());
  }
  const auto pose = pose_in_parent(extrinsic);
  if (!pose) return propagate(pose);
  if (format == Format::tf) return tf_text(*pose, extrinsic.tf_form);
  return format == Format::autoware ? autoware_text(*pose) : urdf_text(*pose);
}

bool is_frame_name(std::string_view name) {
  return !name.empty() && name.size() <= 128 && std::ranges::all_of(name, [](char c) {
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') ||
           std::string_view("_/.-").find(c) != std::string_view::npos;
  }) && name.front() != '-';
}

RigidTransform T_optical_body() {
  RigidTransform T = RigidTransform::Identity();
  T.linear() << 0, -1, 0, 0, 0, -1, 1, 0, 0;
  return T;
}

tl::unexpected<Error> malformed(const TextFile& file, std::string_view what) {
  return fail(ErrorCode::calibration_malformed, file.name + ": " + std::string(what));
}

Result<void> parse_yaml(const TextFile& file, const std::function<void(const ConfigNode&)>& read) {
  const auto parsed = parse_config_text(file.text, file.name, read);
  if (!parsed) return fail(ErrorCode::calibration_malformed, parsed.error().context);
  return {};
}

std::optional<double> parse_number(std::string_view text) {
  if (text.starts_with('+')) text.remove_prefix(1);
  double value{};
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc() || end != text.data() + text.size() || !std::isfinite(value)) return std::nullopt;
  return value;
}

std::string number_text(double value) {
  std::array<char, 32> text;
  std::string number(text.data(), std::to_chars(text.begin(), text.end(), value == 0 ? 0.0 : value).ptr);
  // YAML 1.1 takes a number for text that has neither point nor exponent sign where it needs both.
  if (const auto e = number.find('e'); e != std::string::npos && number.find('.') == std::string::npos)
    number.insert(e, ".0");
  if (number.find_first_of(".e") == std::string::npos) number += ".0";
  return number;
}

std::vector<std::string> words_of(std::string_view text) {
  std::vector<std::string> words;
  constexpr std::string_view blank = " \t\r\n\v\f";
  for (std::size_t at = text.find_first_not_of(blank); at != std::string_view::npos;) {
    const std::size_t end = std::min(text.find_first_of(blank, at), text.size());
    words.emplace_back(text.substr(at, end - at));
    at = text.find_first_not_of(blank, end);
  }
  return words;
}

std::vector<std::array<double, 4>> matrix_rows(const RigidTransform& T, int count) {
  std::vector<std::array<double, 4>> rows;
  for (int i = 0; i < count; ++i) rows.push_back({T(i, 0), T(i, 1), T(i, 2), T(i, 3)});
  return rows;
}

RigidTransform from_xyz_rpy(const Eigen::Vector3d& xyz, const Eigen::Vector3d& rpy) {
  RigidTransform T = RigidTransform::Identity();
  T.linear() = rotation_from_rpy(rpy);
  T.translation() = xyz;
  return T;
}

}  // namespace calib::formats
