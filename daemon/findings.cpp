#include "findings.hpp"

#include <algorithm>

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

bool has_problem(const std::vector<Finding>& findings, std::initializer_list<std::string_view> checks) {
  return std::ranges::any_of(findings, [&](const Finding& finding) {
    return finding.result == FindingResult::problem && std::ranges::find(checks, finding.check) != checks.end();
  });
}

}  // namespace calib
