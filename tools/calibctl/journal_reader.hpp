#pragma once

#include <filesystem>
#include <functional>
#include <optional>
#include <string>

#include "calib/result.hpp"
#include "calib/wall_time.hpp"

namespace calib::ctl {

/// One event that calibd wrote into the journal. Its unit is journald's word (_SYSTEMD_UNIT=), the rest calibd's.
struct JournalEvent {
  WallTime time{};
  int priority = 6;  // syslog's
  std::string message, pair, verdict, reason, cause;
  std::optional<std::uint64_t> record;
};

/// Calls `take` with each event of calibd.service since `since` (of all time if there is none), oldest first. `folder`
/// has the journal's files; the system's journal if it is empty. Fails with `not_found` where there is no journal, and
/// with `denied` where this user may not read it.
[[nodiscard]] Result<void> read_journal(const std::filesystem::path& folder, std::optional<WallTime> since,
                                        const std::function<void(JournalEvent)>& take);

}  // namespace calib::ctl
