#pragma once

#include <filesystem>

#include "calib/status.hpp"

namespace calib {

/// Replaces `file` by the status as JSON, in one step: a reader sees the old or the new one, whole. Not synced: it need
/// not survive a power cut. Fails with `snapshot_failed`.
[[nodiscard]] Result<void> write_snapshot(const std::filesystem::path& file, const Status& status);

}  // namespace calib
