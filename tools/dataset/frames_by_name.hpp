#pragma once

#include <filesystem>
#include <optional>

#include "calib/result.hpp"
#include "dataset/recording.hpp"

namespace calib {

/// The frames of two or three folders, sorted by name: files of the same name but for the extension belong together;
/// and what is missing of the others.
/// Fails with `recording_not_found` when a folder holds no images or no clouds, and with `frame_mismatch` when fewer
/// than half of those there are the fewest of have a counterpart in the other folders.
[[nodiscard]] Result<RecordedFrames> frames_by_name(const std::filesystem::path& images,
                                                    const std::optional<std::filesystem::path>& right_images,
                                                    const std::filesystem::path& clouds);

}  // namespace calib
