#pragma once

#include <chrono>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "calib/status.hpp"
#include "commands.hpp"
#include "record_check.hpp"

namespace calib::ctl {

/// A status as received and as parsed. Verdicts that have expired are `not_evaluated` in both.
struct Report {
  nlohmann::json raw;
  Status status;
  std::vector<RecordCheck> checks;       // one per pair after `check`, none before
  std::optional<double> snapshot_age_s;  // set: calibd does not run, and this is its last snapshot
};

[[nodiscard]] WallTime wall_clock();

/// The status of the running calibd. Fails as `ask`, or with `malformed_status`.
[[nodiscard]] Result<Report> ask_status(const Paths& paths, std::chrono::seconds timeout);
/// The same, or the last snapshot if calibd does not run.
[[nodiscard]] Result<Report> ask_status_or_snapshot(const Paths& paths, std::chrono::seconds timeout);
/// Leaves one pair in the report. Fails with `not_found`.
[[nodiscard]] Result<void> keep_pair(Report& report, const std::string& name);
/// Verifies the records of the pairs.
void check(Report& report, const Paths& paths);
/// After `check`: whether each pair that has a record has one that verifies. A snapshot of which nobody could verify
/// the records passes: it counts as no answer anyway.
[[nodiscard]] bool records_verify(const Report& report);

}  // namespace calib::ctl
