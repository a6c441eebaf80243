#include <map>
#include <utility>
#include <vector>

#include "dataset/encoded_image.hpp"
#include "dataset/frames_by_name.hpp"
#include "dataset/kitti_calibration.hpp"
#include "dataset/recording.hpp"

namespace calib {
namespace {

namespace fs = std::filesystem;

/// What the calibration file of a frame says about one camera.
struct FrameCalibration {
  Eigen::Matrix<double, 3, 4> P;
  std::optional<double> baseline_m;
  RigidTransform T_camera_lidar = RigidTransform::Identity();

  /// All of its numbers: frames with the same ones have the same calibration.
  [[nodiscard]] std::vector<double> numbers() const {
    std::vector<double> all(P.data(), P.data() + P.size());
    all.insert(all.end(), T_camera_lidar.data(), T_camera_lidar.data() + 16);
    all.push_back(baseline_m.value_or(0));
    return all;
  }
};

Result<FrameCalibration> read_calibration(const fs::path& path, bool is_left) {
  const auto file = KittiCalibration::read(path);
  if (!file) return propagate(file);
  const auto P = file->matrix<3, 4>(is_left ? "P2" : "P3");
  if (!P) return propagate(P);
  const auto R_rect = file->rotation("R0_rect");
  if (!R_rect) return propagate(R_rect);
  const auto T_camera0_lidar = file->transform("Tr_velo_to_cam");
  if (!T_camera0_lidar) return propagate(T_camera0_lidar);
  if (!((*P)(0, 0) > 1 && (*P)(1, 1) > 1))
    return fail(ErrorCode::calibration_malformed, path.string() + " has no focal length in P");
  FrameCalibration calibration{*P, std::nullopt};
  if (const auto P_right = file->matrix<3, 4>("P3"); is_left && P_right && (*P_right)(0, 0) > 1)
    calibration.baseline_m = (translation_of(*P) - translation_of(*P_right)).x();
  if (calibration.baseline_m && !(*calibration.baseline_m > 0))
    return fail(ErrorCode::calibration_malformed, path.string() + ": image_3 is not to the right of image_2");
  // x = P R0_rect Tr_velo_to_cam p.
  calibration.T_camera_lidar =
      RigidTransform(Eigen::Translation3d(translation_of(*P))) * RigidTransform(*R_rect) * *T_camera0_lidar;
  return calibration;
}

}  // namespace

Result<Recording> open_kitti_object(const fs::path& root, const std::string& camera_name) {
  const bool is_left = camera_name == "image_2";
  if (!is_left && camera_name != "image_3")
    return fail(ErrorCode::recording_not_found,
                "KITTI's object set has no camera " + escape_control(camera_name) + ", only image_2 and image_3");
  std::error_code error;
  const fs::path folder = fs::is_directory(root / "training", error) ? root / "training" : root;
  if (!fs::is_directory(folder / "velodyne", error))
    return fail(ErrorCode::recording_not_found,
                folder.string() + " has no folder velodyne; --root is the folder with image_2, velodyne and calib");
  const bool has_right = is_left && fs::is_directory(folder / "image_3", error);
  auto frames = frames_by_name(folder / camera_name, has_right ? std::optional(folder / "image_3") : std::nullopt,
                               folder / "velodyne");
  if (!frames) return propagate(frames);

  struct Group {
    FrameCalibration calibration;
    std::vector<RecordedFrame> frames;
  };
  std::map<std::vector<double>, Group> groups;
  for (RecordedFrame& frame : frames->complete) {
    const auto calibration = read_calibration(folder / "calib" / (frame.name + ".txt"), is_left);
    if (!calibration) return propagate(calibration);
    groups.try_emplace(calibration->numbers(), Group{*calibration, {}})
        .first->second.frames.push_back(std::move(frame));
  }
  if (groups.empty()) return fail(ErrorCode::frame_mismatch, "no frame of " + folder.string() + " has image and cloud");
  auto most = groups.begin();
  for (auto group = groups.begin(); group != groups.end(); ++group)
    if (group->second.frames.size() > most->second.frames.size()) most = group;
  for (auto group = groups.begin(); group != groups.end(); ++group)
    for (const RecordedFrame& frame : group->second.frames)
      if (group != most) frames->lacks.push_back("another calibration for " + frame.name);

  const FrameCalibration& calibration = most->second.calibration;
  const auto first = EncodedImage::read(most->second.frames.front().image, ErrorCode::image_unreadable);
  if (!first) return propagate(first);
  auto camera = Camera::make(CameraModel::rectified, static_cast<int>(first->header().width),
                             static_cast<int>(first->header().height),
                             {calibration.P(0, 0), calibration.P(1, 1), calibration.P(0, 2), calibration.P(1, 2)});
  if (!camera) return propagate(camera);
  frames->complete = std::move(most->second.frames);
  return Recording(*std::move(camera), calibration.T_camera_lidar, calibration.baseline_m, *std::move(frames));
}

}  // namespace calib
