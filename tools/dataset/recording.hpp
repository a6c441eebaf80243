#pragma once

#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "calib/camera.hpp"
#include "calib/cloud_layout.hpp"
#include "calib/depth_stereo.hpp"
#include "calib/depth_topic.hpp"
#include "calib/frame.hpp"
#include "calib/geometry.hpp"
#include "calib/result.hpp"
#include "dataset/image_file.hpp"

namespace calib {

/// The files of one moment. `name` is the image's file name without extension: depth files bear it too.
struct RecordedFrame {
  std::string name;
  std::filesystem::path image;
  std::optional<std::filesystem::path> right_image;
  std::filesystem::path cloud;
  /// Where the points of the cloud are at the time of the image, seen from the LiDAR of that time; nothing where the
  /// two were taken at once, or it is not known how the vehicle moved.
  std::optional<RigidTransform> T_image_time_scan_time = {};
};

/// Frames that belong together, and what the others lack, in the order of their names: "no cloud for 0000000004".
struct RecordedFrames {
  std::vector<RecordedFrame> complete;
  std::vector<std::string> lacks;
};

/// What reads a frame that has no files of its own; from any thread.
using FrameReader = std::function<Result<FramePair>(std::size_t index, Colours colours)>;

/// A recording opened for reading: one camera, one LiDAR, frames that belong together. Made by one of the functions
/// below.
class Recording {
 public:
  /// All of `frames` have a right image or none has; `baseline_m` is the distance to the right camera where it is
  /// known.
  Recording(Camera camera, const RigidTransform& T_camera_lidar, std::optional<double> baseline_m,
            RecordedFrames frames)
      : camera_(std::move(camera)),
        T_camera_lidar_(T_camera_lidar),
        baseline_m_(baseline_m),
        frames_(std::move(frames)) {}
  /// Of `frames` only names are looked at, and what others lack.
  Recording(Camera camera, const RigidTransform& T_camera_lidar, std::optional<RightCamera> right,
            RecordedFrames frames, FrameReader reader)
      : camera_(std::move(camera)),
        T_camera_lidar_(T_camera_lidar),
        right_camera_(std::move(right)),
        frames_(std::move(frames)),
        reader_(std::move(reader)) {}

  [[nodiscard]] const Camera& camera() const { return camera_; }
  [[nodiscard]] const RigidTransform& T_camera_lidar() const { return T_camera_lidar_; }
  [[nodiscard]] std::optional<double> baseline_m() const { return baseline_m_; }
  void set_baseline_m(double baseline_m) { baseline_m_ = baseline_m; }
  /// Where the right camera is not known by its baseline alone.
  [[nodiscard]] const std::optional<RightCamera>& right_camera() const { return right_camera_; }
  /// Frames have right images and the right camera is known: what stereo depth needs.
  [[nodiscard]] bool has_stereo() const {
    return right_camera_ || (baseline_m_ && size() > 0 && frames_.complete.front().right_image);
  }
  /// Frames have depth, and the camera that it is of where that is another one.
  [[nodiscard]] bool has_depth() const { return has_depth_; }
  [[nodiscard]] const std::optional<DepthCamera>& depth_camera() const { return depth_camera_; }
  void set_depth(std::optional<DepthCamera> camera) {
    has_depth_ = true;
    depth_camera_ = std::move(camera);
  }

  [[nodiscard]] std::size_t size() const { return frames_.complete.size(); }
  [[nodiscard]] const std::string& frame_name(std::size_t index) const { return frames_.complete[index].name; }
  /// What frames lack that are not among those, a phrase for each.
  [[nodiscard]] const std::vector<std::string>& lacks() const { return frames_.lacks; }

  /// What was chosen, and what looks wrong without being an error; a sentence each.
  [[nodiscard]] const std::vector<std::string>& remarks() const { return remarks_; }
  void set_remarks(std::vector<std::string> remarks) { remarks_ = std::move(remarks); }

  /// How clouds in `.bin` are written, where the user says so.
  void set_cloud_layout(const CloudLayout& layout) { cloud_layout_ = layout; }

  /// Of 16-bit images, where the camera fills fewer than 16.
  void set_image_bits(int bits) { image_bits_ = bits; }

  /// Frame `index` of `size()`; all stamps are `index` x 100 ms, but for messages, which have their own. Fails with
  /// `frame_out_of_range`, `image_unreadable` (or not of the calibration's size), `cloud_unreadable`, `cloud_layout` or
  /// `cloud_empty`; of messages with `malformed:*`, `image_size_mismatch`, `cloud_empty` or `file_unreadable`.
  /// `colours` are those of the left image.
  [[nodiscard]] Result<FramePair> frame(std::size_t index, Colours colours = Colours::grey) const;

 private:
  Camera camera_;
  RigidTransform T_camera_lidar_;
  std::optional<double> baseline_m_;
  std::optional<RightCamera> right_camera_;
  bool has_depth_ = false;
  std::optional<DepthCamera> depth_camera_;
  RecordedFrames frames_;
  FrameReader reader_;  // none: frames are files
  std::vector<std::string> remarks_;
  std::optional<CloudLayout> cloud_layout_;
  int image_bits_ = 16;
};

// Each of the following fails with `recording_not_found` (no such folder, or one without images or clouds),
// `calibration_missing`, `calibration_malformed`, `bad_camera` or `frame_mismatch` (fewer than half of the images or
// of the clouds, whichever are fewer, have a counterpart). Frames are those that have image and cloud, and a right
// image where the camera has a right neighbour with images.

/// A synchronised and rectified KITTI raw drive, `drive` = `<date>/<drive>`, with the calibration files of its date in
/// the folder above. `camera` is image_00 .. image_03; image_00 and image_02 have a right neighbour.
/// The extrinsic is the camera's own: the translation in the fourth column of P_rect is part of it.
/// Geiger et al., "Vision meets Robotics: The KITTI Dataset", IJRR 2013.
[[nodiscard]] Result<Recording> open_kitti_raw(const std::filesystem::path& drive,
                                               const std::string& camera = "image_02");

/// A drive of KITTI-360 below `root` (`calibration/`, `data_2d_raw/<drive>`, `data_3d_raw/<drive>`). `camera` is
/// image_00 or image_01 (perspective, rectified; image_00 has the right neighbour) or image_02 or image_03 (fisheye,
/// Mei's model). Liao et al., "KITTI-360", TPAMI 2022.
[[nodiscard]] Result<Recording> open_kitti_360(const std::filesystem::path& root, const std::string& drive,
                                               const std::string& camera = "image_00");

/// The object detection set of KITTI: `root` has image_2, velodyne, calib and, for stereo depth, image_3, or is the
/// folder above. `camera` is image_2 or image_3. Each frame has a calibration of its own: frames of the one that most
/// have make the recording, and the others are left out. Geiger et al., CVPR 2012.
[[nodiscard]] Result<Recording> open_kitti_object(const std::filesystem::path& root,
                                                  const std::string& camera = "image_2");

/// Key frames of nuScenes: `root` has samples and one folder of tables (v1.0-mini, v1.0-trainval, ...), or is one of
/// several such folders. `camera` is a channel; `scene` a name such as scene-0061, or empty for all: then as with
/// `open_kitti_object`, by the calibration of the vehicle. Camera and LiDAR are triggered at different times: points
/// are moved to the time of the image by the poses of the vehicle. Caesar et al., CVPR 2020.
[[nodiscard]] Result<Recording> open_nuscenes(const std::filesystem::path& root,
                                              const std::string& camera = "CAM_FRONT", const std::string& scene = "");

/// Any other recording, described by a YAML file of calibd's own: README.md beside this header.
[[nodiscard]] Result<Recording> open_list(const std::filesystem::path& yaml);

}  // namespace calib
