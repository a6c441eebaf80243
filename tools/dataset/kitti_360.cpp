#include <yaml-cpp/yaml.h>

#include <array>

#include "calib/file.hpp"
#include "dataset/frames_by_name.hpp"
#include "dataset/kitti_calibration.hpp"
#include "dataset/recording.hpp"

namespace calib {
namespace {

namespace fs = std::filesystem;

/// A fisheye's file, as camodocal writes it with OpenCV. Its `%YAML:1.0` is no directive that others know, and skipped.
Result<Camera> read_fisheye(const fs::path& path) {
  constexpr std::uint64_t most_bytes = 1 << 20;
  const auto text = read_regular_file(path, most_bytes);
  if (!text)
    return fail(ErrorCode::calibration_missing, text.error().context + "; it comes with the data set's calibration");
  std::array<double, 11> values{};
  try {
    const YAML::Node file = YAML::Load(*text);
    const YAML::Node mirror = file["mirror_parameters"], distortion = file["distortion_parameters"],
                     projection = file["projection_parameters"];
    values = {file["image_width"].as<double>(),  file["image_height"].as<double>(), projection["gamma1"].as<double>(),
              projection["gamma2"].as<double>(), projection["u0"].as<double>(),     projection["v0"].as<double>(),
              mirror["xi"].as<double>(),         distortion["k1"].as<double>(),     distortion["k2"].as<double>(),
              distortion["p1"].as<double>(),     distortion["p2"].as<double>()};
  } catch (const YAML::Exception&) {
    return fail(ErrorCode::calibration_malformed, path.string() +
                                                      " is not YAML with the numbers image_width, image_height, "
                                                      "mirror_parameters xi, distortion_parameters k1 k2 p1 p2, "
                                                      "projection_parameters gamma1 gamma2 u0 v0");
  }
  const auto& [width, height, gamma1, gamma2, u0, v0, xi, k1, k2, p1, p2] = values;
  if (!(width >= 1 && width <= 1e5 && height >= 1 && height <= 1e5))
    return fail(ErrorCode::calibration_malformed, path.string() + " gives no size of an image");
  return Camera::make(CameraModel::mei, static_cast<int>(width), static_cast<int>(height), {gamma1, gamma2, u0, v0},
                      {xi, k1, k2, p1, p2});
}

/// From the LiDAR to camera `name` before any rectification.
Result<RigidTransform> read_extrinsic(const fs::path& calibration, const std::string& name) {
  const auto to_lidar = KittiCalibration::read(calibration / "calib_cam_to_velo.txt");
  if (!to_lidar) return propagate(to_lidar);
  const auto T_lidar_camera0 = to_lidar->transform("");
  if (!T_lidar_camera0 || name == "image_00") return T_lidar_camera0.map([](const auto& T) { return T.inverse(); });
  const auto poses = KittiCalibration::read(calibration / "calib_cam_to_pose.txt");
  if (!poses) return propagate(poses);
  const auto T_pose_camera0 = poses->transform("image_00"), T_pose_camera = poses->transform(name);
  if (!T_pose_camera0) return T_pose_camera0;
  if (!T_pose_camera) return T_pose_camera;
  return RigidTransform((*T_lidar_camera0 * T_pose_camera0->inverse() * *T_pose_camera).inverse());
}

}  // namespace

Result<Recording> open_kitti_360(const fs::path& root, const std::string& drive, const std::string& camera_name) {
  const bool perspective = camera_name == "image_00" || camera_name == "image_01";
  if (!perspective && camera_name != "image_02" && camera_name != "image_03")
    return fail(ErrorCode::recording_not_found,
                "KITTI-360 has no camera " + escape_control(camera_name) + ", only image_00 .. image_03");
  const fs::path calibration = root / "calibration", images = root / "data_2d_raw" / drive;
  std::error_code error;
  if (!fs::is_directory(images, error))
    return fail(ErrorCode::recording_not_found, images.string() + " is not a folder");
  auto T_camera_lidar = read_extrinsic(calibration, camera_name);
  if (!T_camera_lidar) return propagate(T_camera_lidar);

  std::optional<Camera> camera;
  std::optional<double> baseline_m;
  std::optional<fs::path> right_images;
  if (perspective) {
    const std::string number = camera_name.substr(6);
    const auto file = KittiCalibration::read(calibration / "perspective.txt");
    if (!file) return propagate(file);
    const auto rectified = KittiRectifiedCamera::read(*file, number);
    if (!rectified) return propagate(rectified);
    const auto R_rect = file->rotation("R_rect_" + number);
    if (!R_rect) return propagate(R_rect);
    camera = rectified->camera;
    // The place of image_01 is in its pose already: the fourth column of its P_rect says it once more.
    *T_camera_lidar = RigidTransform(*R_rect) * *T_camera_lidar;
    if (number == "00") {
      const auto known = kitti_baseline_m(*file, "00", "01");
      if (!known) return propagate(known);
      baseline_m = *known;
      if (const fs::path there = images / "image_01/data_rect"; fs::is_directory(there, error)) right_images = there;
    }
  } else {
    auto fisheye = read_fisheye(calibration / (camera_name + ".yaml"));
    if (!fisheye) return propagate(fisheye);
    camera = *std::move(fisheye);
  }
  auto frames = frames_by_name(images / camera_name / (perspective ? "data_rect" : "data_rgb"), right_images,
                               root / "data_3d_raw" / drive / "velodyne_points/data");
  if (!frames) return propagate(frames);
  return Recording(*std::move(camera), *T_camera_lidar, baseline_m, *std::move(frames));
}

}  // namespace calib
