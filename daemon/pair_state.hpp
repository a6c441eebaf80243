#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <string_view>

#include "calib/drift.hpp"
#include "calib/status.hpp"

namespace calib {

/// What a pair's monitor remembers across restarts, beside the records.
struct PairState {
  DriftState drift;
  Verdict verdict = Verdict::not_evaluated;
  std::string reason = "no pair was evaluated yet";
  WallTime since{};
  std::optional<WallTime> last_evaluated;
  std::uint64_t evaluated = 0;
  std::map<std::string, std::uint64_t> skipped;
  std::optional<PairStatus::Score> score;
  /// Stamp of the last evaluated image: the same one is not evidence twice.
  Timestamp last_stamp{};
  /// The record of a proposal that waits for an answer.
  std::optional<std::uint64_t> proposed_record;
  /// Recalibrations refused since the extrinsic was accepted; each doubles the pairs waited for.
  int refusals = 0;
};

[[nodiscard]] std::string to_text(const PairState& state);
/// Fails with `malformed_state`: the daemon then begins anew for this pair, and says so.
[[nodiscard]] Result<PairState> parse_pair_state(std::string_view text);

}  // namespace calib
