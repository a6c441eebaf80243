#pragma once

#include "extrinsic_formats/formats.hpp"

namespace calib::formats {

/// What files say together.
struct LoadedFrames {
  FrameGraph graph;
  /// The names of the two sensors' frames where the files leave no choice.
  std::optional<std::string> camera, lidar;
  std::string remark;
};

/// Reads `files` of one format, and `with`: more files, each `FILE` of that format or `FORMAT:FILE`.
/// Fails as `read_regular_file` and `read_frames` do.
[[nodiscard]] Result<LoadedFrames> load_frames(Format format, const std::vector<std::filesystem::path>& files,
                                               const std::vector<std::string>& with);

[[nodiscard]] std::optional<Format> parse_format(std::string_view name);

}  // namespace calib::formats
