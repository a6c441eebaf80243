#pragma once

#include <optional>
#include <string>
#include <vector>

#include "calib/status.hpp"
#include "record_check.hpp"

namespace calib::ctl {

/// What a person reads; `snapshot_age_s` when it comes from the snapshot of a daemon that does not run.
[[nodiscard]] std::string status_text(const Status& status, const std::vector<RecordCheck>& checks,
                                      WallTime now, std::optional<double> snapshot_age_s, bool coloured);

}  // namespace calib::ctl
