#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <string_view>

#include "calib/drift.hpp"
#include "calib/status.hpp"

namespace calib {

/// How an extrinsic that was accepted does against the one that it replaced, on pairs taken since: running moments
/// (Welford 1962) of the gain in score, pair by pair.
struct Probation {
  int pairs = 0;
  double gain = 0, gain_squares = 0;  // mean, sum of squared deviations

  void add(double pair_gain);
  /// Of `gain`; infinite below two pairs.
  [[nodiscard]] double standard_error() const;
  /// Whether the gain is more than `sigmas` standard errors above zero; negative: below.
  [[nodiscard]] bool exceeds(double sigmas) const;
};

/// What a pair's watch remembers across restarts, beside the records.
struct PairState {
  DriftState drift;
  /// Digest of what `drift` was measured with; empty while there is none.
  std::string evidence_sha256;
  Verdict verdict = Verdict::not_evaluated;
  std::string reason = "no pair was evaluated yet";
  /// Why the extrinsic in force must not be called calibrated whatever is learned at it; nothing when it may. Ends when an
  /// extrinsic is put in force.
  std::optional<std::string> unresolved;
  WallTime since{};
  std::optional<WallTime> last_evaluated;
  std::uint64_t evaluated = 0;
  std::map<std::string, std::uint64_t> skipped;
  std::optional<PairStatus::Score> score;
  /// Stamp of the last evaluated image: the same one is not evidence twice.
  Timestamp last_stamp{};
  /// The record of a proposal that waits for an answer.
  std::optional<std::uint64_t> proposed_record;
  /// While the extrinsic in force is on probation.
  std::optional<Probation> probation;
  /// Recalibrations in turn that were refused, or did not stand their probation. Each doubles what calibd waits for
  /// before it tries again by itself: until `evaluated` is `retry_at`, and for a time since the last one.
  int refusals = 0;
  std::uint64_t retry_at = 0;
  std::optional<WallTime> recalibrated;
};

[[nodiscard]] std::string to_text(const PairState& state);
/// Fails with `malformed_state`: the daemon then begins anew for this pair, and says so.
[[nodiscard]] Result<PairState> parse_pair_state(std::string_view text);

}  // namespace calib
