#pragma once

#include <chrono>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

#include "calib/result.hpp"

namespace calib {

/// The state of a pair's calibration. `not_evaluated` is a normal state, always with a reason, never shown as
/// OK.
enum class Verdict { not_evaluated, calibrated, suspect, drifted };

[[nodiscard]] std::string_view to_string(Verdict verdict);
[[nodiscard]] Result<Verdict> parse_verdict(std::string_view text);

/// A moment that no clock adjustment changes: the kernel's boot id, and the time since that boot (CLOCK_BOOTTIME).
struct BootTime {
  std::string boot_id;
  std::chrono::nanoseconds since_boot{};
};

/// The grounds of a verdict.
struct Grounds {
  /// Pairs that the present process has evaluated at the extrinsic in force.
  std::uint64_t pairs = 0;
  /// When the last of them was received, and how long it carries a verdict.
  BootTime taken;
  std::chrono::nanoseconds lifetime{};
  /// Digest of what the evidence was measured with, and its baseline too: evidence of another one is set aside.
  std::string evidence_sha256;
  /// Why the verdict is not written down durably; nothing when it is.
  std::optional<std::string> not_written;
};

/// Evidence is judged by the median of the latest three pairs: so many must be of the present process before it can say
/// that all is well.
inline constexpr std::uint64_t least_pairs_to_confirm = 3;

/// What may be said of a pair.
struct Claim {
  Verdict verdict = Verdict::not_evaluated;
  /// Of `not_evaluated` and of no other verdict: why there is none.
  std::optional<ErrorCode> cause;
  std::string reason;
};

/// The one place that decides what is shown: `calibrated` needs evidence that the present process has gathered or
/// confirmed, that is no older than its lifetime, and that is written down. `suspect` and `drifted` need the same, but
/// the confirmation. Anything else is `not_evaluated`, whose cause is `starting`, `store_failed` or `stale`; its reason
/// begins with that word and ends with what was said before. Programs that read a status apply it again, by their own
/// clock: what it has made of a verdict stays so.
[[nodiscard]] Claim claim(const Claim& by_evidence, const std::optional<Grounds>& grounds, const BootTime& now);

}  // namespace calib
