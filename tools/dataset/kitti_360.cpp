#include <array>
#include <opencv2/core.hpp>

#include "dataset/frames_by_name.hpp"
#include "dataset/kitti_calibration.hpp"
#include "dataset/recording.hpp"

namespace calib {
namespace {

namespace fs = std::filesystem;

/// A fisheye's file, in the OpenCV dialect of YAML that camodocal writes.
Result<Camera> read_fisheye(const fs::path& path) {
  if (std::error_code error; !fs::is_regular_file(path, error))
    return fail("calibration_missing", path.string() + " cannot be read; it comes with the data set's calibration");
  std::array<double, 11> values{};
  try {
    const cv::FileStorage file(path.string(), cv::FileStorage::READ);
    const cv::FileNode mirror = file["mirror_parameters"], distortion = file["distortion_parameters"],
                       projection = file["projection_parameters"];
    const std::array nodes{file["image_width"], file["image_height"], projection["gamma1"], projection["gamma2"],
                           projection["u0"],    projection["v0"],     mirror["xi"],         distortion["k1"],
                           distortion["k2"],    distortion["p1"],     distortion["p2"]};
    for (std::size_t i = 0; i < nodes.size(); ++i) {
      if (!nodes[i].isReal() && !nodes[i].isInt())
        return fail("calibration_malformed",
                    path.string() +
                        " lacks one of image_width, image_height, mirror_parameters xi, "
                        "distortion_parameters k1 k2 p1 p2, projection_parameters gamma1 gamma2 u0 v0");
      values[i] = nodes[i].real();
    }
  } catch (const cv::Exception&) {
    return fail("calibration_malformed", path.string() + " is not a YAML file that OpenCV reads");
  }
  const auto& [width, height, gamma1, gamma2, u0, v0, xi, k1, k2, p1, p2] = values;
  if (!(width >= 1 && width <= 1e5 && height >= 1 && height <= 1e5))
    return fail("calibration_malformed", path.string() + " gives no size of an image");
  return Camera::make(CameraModel::mei, static_cast<int>(width), static_cast<int>(height), {gamma1, gamma2, u0, v0},
                      {xi, k1, k2, p1, p2});
}

/// From the LiDAR to camera `name` before any rectification.
Result<RigidTransform> read_extrinsic(const fs::path& calibration, const std::string& name) {
  const auto to_lidar = KittiCalibration::read(calibration / "calib_cam_to_velo.txt");
  if (!to_lidar) return tl::unexpected(to_lidar.error());
  const auto T_lidar_camera0 = to_lidar->transform("");
  if (!T_lidar_camera0 || name == "image_00") return T_lidar_camera0.map([](const auto& T) { return T.inverse(); });
  const auto poses = KittiCalibration::read(calibration / "calib_cam_to_pose.txt");
  if (!poses) return tl::unexpected(poses.error());
  const auto T_pose_camera0 = poses->transform("image_00"), T_pose_camera = poses->transform(name);
  if (!T_pose_camera0) return T_pose_camera0;
  if (!T_pose_camera) return T_pose_camera;
  return RigidTransform((*T_lidar_camera0 * T_pose_camera0->inverse() * *T_pose_camera).inverse());
}

}  // namespace

Result<Recording> open_kitti_360(const fs::path& root, const std::string& drive, const std::string& camera_name) {
  const bool perspective = camera_name == "image_00" || camera_name == "image_01";
  if (!perspective && camera_name != "image_02" && camera_name != "image_03")
    return fail("recording_not_found",
                "KITTI-360 has no camera " + escape_control(camera_name) + ", only image_00 .. image_03");
  const fs::path calibration = root / "calibration", images = root / "data_2d_raw" / drive;
  std::error_code error;
  if (!fs::is_directory(images, error)) return fail("recording_not_found", images.string() + " is not a folder");
  auto T_camera_lidar = read_extrinsic(calibration, camera_name);
  if (!T_camera_lidar) return tl::unexpected(T_camera_lidar.error());

  std::optional<Camera> camera;
  std::optional<double> baseline_m;
  std::optional<fs::path> right_images;
  if (perspective) {
    const std::string number = camera_name.substr(6);
    const auto file = KittiCalibration::read(calibration / "perspective.txt");
    if (!file) return tl::unexpected(file.error());
    const auto rectified = KittiRectifiedCamera::read(*file, number);
    if (!rectified) return tl::unexpected(rectified.error());
    const auto R_rect = file->rotation("R_rect_" + number);
    if (!R_rect) return tl::unexpected(R_rect.error());
    camera = rectified->camera;
    // The place of image_01 is in its pose already: the fourth column of its P_rect says it once more.
    *T_camera_lidar = RigidTransform(*R_rect) * *T_camera_lidar;
    if (number == "00") {
      const auto known = kitti_baseline_m(*file, "00", "01");
      if (!known) return tl::unexpected(known.error());
      baseline_m = *known;
      if (const fs::path there = images / "image_01/data_rect"; fs::is_directory(there, error)) right_images = there;
    }
  } else {
    auto fisheye = read_fisheye(calibration / (camera_name + ".yaml"));
    if (!fisheye) return tl::unexpected(fisheye.error());
    camera = *std::move(fisheye);
  }
  auto frames = frames_by_name(images / camera_name / (perspective ? "data_rect" : "data_rgb"), right_images,
                               root / "data_3d_raw" / drive / "velodyne_points/data");
  if (!frames) return tl::unexpected(frames.error());
  return Recording(*std::move(camera), *T_camera_lidar, baseline_m, *std::move(frames));
}

}  // namespace calib
