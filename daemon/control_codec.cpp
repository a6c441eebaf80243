#include "control_codec.hpp"

#include <nlohmann/json.hpp>

namespace calib {
namespace {

nlohmann::json to_json(const PairFinding& check) {
  const Finding& finding = check.finding;
  nlohmann::json json{{"pair", check.pair},
                      {"check", finding.check},
                      {"result", to_string(finding.result)},
                      {"seen", escape_control(finding.seen)}};
  if (finding.code.empty()) return json;
  json["code"] = finding.code;
  json["cause"] = escape_control(finding.cause);
  json["remedy"] = escape_control(finding.remedy);
  return json;
}

}  // namespace

nlohmann::json to_json(const DiagnosisReport& report) {
  nlohmann::json json{{"ok", true}, {"checks", nlohmann::json::array()}, {"overlays", nlohmann::json::array()}};
  for (const PairFinding& check : report.checks) json["checks"].push_back(to_json(check));
  for (const Overlay& overlay : report.overlays)
    json["overlays"].push_back({{"pair", overlay.pair}, {"file", overlay.file.string()}});
  return json;
}

}  // namespace calib
