#pragma once

#include <optional>
#include <string>
#include <vector>

#include "calib/status.hpp"
#include "record_check.hpp"
#include "text.hpp"

namespace calib::ctl {

// Statuses for people, in lines of at most `Text::max_width` characters. `snapshot_age_s` is set when the daemon does
// not run and the status is its last snapshot.

/// One row a pair; four pairs fit on a screen of 24 lines.
[[nodiscard]] std::string status_table(const Status& status, const std::vector<RecordCheck>& checks, WallTime now,
                                       std::optional<double> snapshot_age_s, bool coloured);
/// Everything about each pair.
[[nodiscard]] std::string status_text(const Status& status, const std::vector<RecordCheck>& checks, WallTime now,
                                      std::optional<double> snapshot_age_s, bool coloured);

// What both consist of.

/// Vehicle, daemon, and what concerns all pairs.
[[nodiscard]] std::string head_text(const Status& status, std::optional<double> snapshot_age_s, bool coloured);
[[nodiscard]] Colour colour_of(Verdict verdict);
/// `not evaluated`.
[[nodiscard]] std::string words_of(Verdict verdict);
/// For times that are further apart than a count of nanoseconds can hold, too.
[[nodiscard]] double seconds_between(WallTime from, WallTime to);
/// `12.3 min`.
[[nodiscard]] std::string duration(double seconds);
/// `12 min`.
[[nodiscard]] std::string short_duration(double seconds);

}  // namespace calib::ctl
