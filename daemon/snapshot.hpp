#pragma once

#include <filesystem>

#include "calib/status.hpp"

namespace calib {

/// Replaces `file` by the status as JSON, atomically: a reader sees the old file or the new one, complete. Not synced
/// to disk: it need not survive a power cut. Fails with `snapshot_failed`.
[[nodiscard]] Result<void> write_snapshot(const std::filesystem::path& file, const Status& status);

}  // namespace calib
