#include "calib/claim.hpp"

#include <algorithm>
#include <array>

namespace calib {
namespace {

constexpr std::array<Verdict, 4> verdicts{Verdict::not_evaluated, Verdict::calibrated, Verdict::suspect,
                                          Verdict::drifted};

std::string seconds(std::chrono::nanoseconds duration) {
  return std::to_string(std::chrono::round<std::chrono::seconds>(duration).count()) + " s";
}

/// Why the grounds carry no verdict of this kind; nothing when they do.
std::optional<std::string> objection(Verdict verdict, const Grounds& grounds, const BootTime& now) {
  if (grounds.not_written) return "store_failed: " + *grounds.not_written;
  if (grounds.taken.boot_id != now.boot_id) return "stale: the last evidence is from before the machine was started";
  const auto age = now.since_boot - grounds.taken.since_boot;
  if (age < age.zero() || age > grounds.lifetime)
    return "stale: the last evidence is older than the " + seconds(grounds.lifetime) + " that it counts for";
  const std::uint64_t needed = verdict == Verdict::calibrated ? least_pairs_to_confirm : 1;
  if (grounds.pairs < needed)
    return "starting: " + std::to_string(grounds.pairs) + " of " + std::to_string(needed) +
           " pairs evaluated since calibd started";
  return std::nullopt;
}

}  // namespace

std::string_view to_string(Verdict verdict) {
  switch (verdict) {
    case Verdict::not_evaluated:
      return "not_evaluated";
    case Verdict::calibrated:
      return "calibrated";
    case Verdict::suspect:
      return "suspect";
    case Verdict::drifted:
      return "drifted";
  }
  return "";
}

Result<Verdict> parse_verdict(std::string_view text) {
  const auto found = std::ranges::find_if(verdicts, [&](Verdict verdict) { return to_string(verdict) == text; });
  if (found == verdicts.end()) return fail(ErrorCode::bad_verdict, "'" + std::string(text) + "' is not a verdict");
  return *found;
}

Claim claim(const Claim& by_evidence, const std::optional<Grounds>& grounds, const BootTime& now) {
  if (by_evidence.verdict == Verdict::not_evaluated) {
    constexpr std::string_view store_failed = "store_failed: ";
    if (!grounds || !grounds->not_written || by_evidence.reason.starts_with(store_failed)) return by_evidence;
    return {Verdict::not_evaluated, std::string(store_failed) + *grounds->not_written};
  }
  const auto no = grounds ? objection(by_evidence.verdict, *grounds, now)
                          : std::optional<std::string>("starting: no pair was evaluated since calibd started");
  if (!no) return by_evidence;
  return {Verdict::not_evaluated,
          *no + "; it was " + std::string(to_string(by_evidence.verdict)) + " when last evaluated"};
}

}  // namespace calib
