#include "findings.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

namespace calib {

std::string_view to_string(FindingResult result) {
  switch (result) {
    case FindingResult::ok:
      return "ok";
    case FindingResult::warning:
      return "warning";
    case FindingResult::problem:
      return "problem";
    case FindingResult::not_checked:
      break;
  }
  return "not_checked";
}

std::vector<Finding> diagnose(const PairObservation& seen) {
  std::vector<Finding> findings;
  diagnose_samples(seen, findings);
  diagnose_geometry(seen, findings);
  return findings;
}

std::string duration_words(std::chrono::nanoseconds time) {
  const double s = std::abs(std::chrono::duration<double>(time).count());
  if (s < 120) return fmt::format("{:.1f} s", s);
  if (s < 2 * 3600) return fmt::format("{:.0f} min", s / 60);
  if (s < 2 * 86400) return fmt::format("{:.0f} h", s / 3600);
  if (s < 730.0 * 86400) return fmt::format("{:.0f} days", s / 86400);
  return fmt::format("{:.0f} years", s / 86400 / 365.25);
}

bool has_problem(const std::vector<Finding>& findings, std::initializer_list<std::string_view> checks) {
  return std::ranges::any_of(findings, [&](const Finding& finding) {
    return finding.result == FindingResult::problem && std::ranges::find(checks, finding.check) != checks.end();
  });
}

}  // namespace calib
