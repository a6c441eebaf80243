#include <algorithm>
#include <array>

#include "dataset/frames_by_name.hpp"
#include "dataset/kitti_calibration.hpp"
#include "dataset/recording.hpp"

namespace calib {

namespace fs = std::filesystem;

Result<Recording> open_kitti_raw(const fs::path& folder, const std::string& camera_name) {
  constexpr std::array names{"image_00", "image_01", "image_02", "image_03"};
  if (std::ranges::find(names, camera_name) == names.end())
    return fail(ErrorCode::recording_not_found,
                "KITTI raw has no camera " + escape_control(camera_name) + ", only image_00 .. image_03");
  const std::string number = camera_name.substr(6);
  const fs::path drive = folder.has_filename() ? folder : folder.parent_path();
  std::error_code error;
  if (!fs::is_directory(drive, error)) return fail(ErrorCode::recording_not_found, drive.string() + " is not a folder");
  const fs::path date = fs::absolute(drive, error).parent_path();

  const auto cameras = KittiCalibration::read(date / "calib_cam_to_cam.txt");
  if (!cameras) return propagate(cameras);
  const auto lidar = KittiCalibration::read(date / "calib_velo_to_cam.txt");
  if (!lidar) return propagate(lidar);
  const auto R_camera0_lidar = lidar->rotation("R");
  if (!R_camera0_lidar) return propagate(R_camera0_lidar);
  const auto t_camera0_lidar = lidar->matrix<3, 1>("T");
  if (!t_camera0_lidar) return propagate(t_camera0_lidar);
  const auto R_rect = cameras->rotation("R_rect_00");
  if (!R_rect) return propagate(R_rect);
  const auto rectified = KittiRectifiedCamera::read(*cameras, number);
  if (!rectified) return propagate(rectified);

  std::optional<double> baseline_m;
  std::optional<fs::path> right_images;
  if (number == "00" || number == "02") {
    const std::string right = number == "00" ? "01" : "03";
    const auto known = kitti_baseline_m(*cameras, number, right);
    if (!known) return propagate(known);
    baseline_m = *known;
    if (const fs::path there = drive / ("image_" + right) / "data"; fs::is_directory(there, error))
      right_images = there;
  }
  auto frames = frames_by_name(drive / camera_name / "data", right_images, drive / "velodyne_points/data");
  if (!frames) return propagate(frames);

  // x = P_rect_NN R_rect_00 T_camera0_lidar p.
  RigidTransform T_camera_lidar = RigidTransform::Identity();
  T_camera_lidar.linear() = *R_rect * *R_camera0_lidar;
  T_camera_lidar.translation() = *R_rect * *t_camera0_lidar + rectified->t_m;
  return Recording(rectified->camera, T_camera_lidar, baseline_m, *std::move(frames));
}

}  // namespace calib
