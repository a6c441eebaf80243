#pragma once

#include <optional>
#include <string>
#include <vector>

#include "calib/status.hpp"
#include "record_check.hpp"

namespace calib::ctl {

/// The status for people, in lines of at most `Text::max_width` characters. `snapshot_age_s` is set when the daemon
/// does not run and the status is its last snapshot.
[[nodiscard]] std::string status_text(const Status& status, const std::vector<RecordCheck>& checks, WallTime now,
                                      std::optional<double> snapshot_age_s, bool coloured);

}  // namespace calib::ctl
