#include "doctor.hpp"

#include <algorithm>
#include <nlohmann/json.hpp>

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

std::vector<Finding> diagnose(const PairSeen& seen) {
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

nlohmann::json to_json(const Finding& finding, const std::string& pair) {
  nlohmann::json json{{"pair", pair},
                      {"check", finding.check},
                      {"result", to_string(finding.result)},
                      {"seen", escape_control(finding.seen)}};
  if (finding.code.empty()) return json;
  json["code"] = finding.code;
  json["cause"] = escape_control(finding.cause);
  json["remedy"] = escape_control(finding.remedy);
  return json;
}

}  // namespace calib
