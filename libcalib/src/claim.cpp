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
std::optional<Error> objection(Verdict verdict, const Grounds& grounds, const BootTime& now) {
  if (grounds.not_written) return Error{ErrorCode::store_failed, *grounds.not_written};
  if (grounds.taken.boot_id != now.boot_id)
    return Error{ErrorCode::stale, "the last evidence is from before the machine was started"};
  const auto age = now.since_boot - grounds.taken.since_boot;
  if (age < age.zero() || age > grounds.lifetime)
    return Error{ErrorCode::stale,
                 "the last evidence is older than the " + seconds(grounds.lifetime) + " that it counts for"};
  const std::uint64_t needed = verdict == Verdict::calibrated ? least_pairs_to_confirm : 1;
  if (grounds.pairs < needed)
    return Error{ErrorCode::starting, std::to_string(grounds.pairs) + " of " + std::to_string(needed) +
                                          " pairs evaluated since calibd started"};
  return std::nullopt;
}

Claim not_evaluated(const Error& why, const std::string& more = "") {
  return {Verdict::not_evaluated, why.code, std::string(to_string(why.code)) + ": " + why.context + more};
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
    if (!grounds || !grounds->not_written || by_evidence.cause == ErrorCode::store_failed) return by_evidence;
    return not_evaluated({ErrorCode::store_failed, *grounds->not_written});
  }
  const auto why = grounds ? objection(by_evidence.verdict, *grounds, now)
                           : Error{ErrorCode::starting, "no pair was evaluated since calibd started"};
  if (!why) return by_evidence;
  return not_evaluated(*why, "; it was " + std::string(to_string(by_evidence.verdict)) + " when last evaluated");
}

}  // namespace calib
