#pragma once

#include <filesystem>

#include "dataset/bag/bag_options.hpp"
#include "dataset/recording.hpp"

namespace calib {

/// A recording of rosbag2 (`Bag`), without ROS. Messages are decoded by calibd's own decoders and paired by its own
/// rule. The camera is that of CameraInfo, the extrinsic that of /tf_static (or of /tf, as far as it never changes)
/// between the frames of the messages, unless `options.calibration` gives them. Fails as `Bag::open` and
/// `choose_topics` do; as `read_calibration_file` does; with `camera_info_missing`, `camera_info_mismatch` or
/// `bad_camera`; with `calibration_missing` when there is no extrinsic; with `frame_mismatch` when no image and cloud
/// were taken at the same time; and with `malformed:*` when no image, or no CameraInfo, can be decoded.
[[nodiscard]] Result<Recording> open_rosbag2(const std::filesystem::path& path, const BagOptions& options);

}  // namespace calib
