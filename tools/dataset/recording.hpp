#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "calib/camera.hpp"
#include "calib/cloud_layout.hpp"
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
};

/// Frames that belong together, and what the others lack, in the order of their names: "no cloud for 0000000004".
struct RecordedFrames {
  std::vector<RecordedFrame> complete;
  std::vector<std::string> lacks;
};

/// A recording opened for reading: one camera, one LiDAR, frames that belong together. Made by one of the functions
/// below; holds no file open.
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

  [[nodiscard]] const Camera& camera() const { return camera_; }
  [[nodiscard]] const RigidTransform& T_camera_lidar() const { return T_camera_lidar_; }
  [[nodiscard]] std::optional<double> baseline_m() const { return baseline_m_; }
  /// Frames have right images and the baseline is known: what stereo depth needs.
  [[nodiscard]] bool has_stereo() const { return baseline_m_ && size() > 0 && frames_.complete.front().right_image; }

  [[nodiscard]] std::size_t size() const { return frames_.complete.size(); }
  [[nodiscard]] const std::string& frame_name(std::size_t index) const { return frames_.complete[index].name; }
  /// What frames lack that are not among those, a phrase for each.
  [[nodiscard]] const std::vector<std::string>& lacks() const { return frames_.lacks; }

  /// How clouds in `.bin` are written, where the user says so.
  void set_cloud_layout(const CloudLayout& layout) { cloud_layout_ = layout; }

  /// Of 16-bit images, where the camera fills fewer than 16.
  void set_image_bits(int bits) { image_bits_ = bits; }

  /// Frame `index` of `size()`; all stamps are `index` x 100 ms. Fails with `frame_out_of_range`, `image_unreadable`
  /// (or not of the calibration's size), `cloud_unreadable`, `cloud_layout` or `cloud_empty`. `colours` are those of
  /// the left image.
  [[nodiscard]] Result<FramePair> frame(std::size_t index, Colours colours = Colours::grey) const;

 private:
  Camera camera_;
  RigidTransform T_camera_lidar_;
  std::optional<double> baseline_m_;
  RecordedFrames frames_;
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

/// Any other recording, described by a YAML file of calibd's own: README.md beside this header.
[[nodiscard]] Result<Recording> open_list(const std::filesystem::path& yaml);

}  // namespace calib
