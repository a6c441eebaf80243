#include "drift_alert.hpp"

#include <limits>
#include <nlohmann/json.hpp>

#include "calib/json_integer.hpp"

namespace calib {
namespace {

using nlohmann::json;

double number(const json& value) {
  return value.is_null() ? std::numeric_limits<double>::infinity() : value.get<double>();
}

Vector6 six(const json& first, const json& last) {
  Vector6 values;
  for (int i = 0; i < 3; ++i) {
    values[i] = number(first.at(i));
    values[i + 3] = number(last.at(i));
  }
  return values;
}

}  // namespace

std::string alert_text(const DriftAlert& alert) {
  const auto three = [](const auto& vector) { return json{vector[0], vector[1], vector[2]}; };  // null: infinite
  return json{{"schema", 1},
              {"alert_sequence", alert.alert_sequence},
              {"stamp", rfc3339_ns(alert.stamp)},
              {"vehicle", alert.vehicle},
              {"pair", alert.pair},
              {"verdict", to_string(alert.verdict)},
              {"previous_verdict", to_string(alert.previous_verdict)},
              {"reason", alert.reason},
              {"rotation_rad", three(alert.misalignment.delta.head<3>())},
              {"translation_m", three(alert.misalignment.delta.tail<3>())},
              {"sigma_rotation_rad", three(alert.misalignment.sigma.head<3>())},
              {"sigma_translation_m", three(alert.misalignment.sigma.tail<3>())},
              {"record_sequence", alert.record_sequence}}
      .dump(-1, ' ', false, json::error_handler_t::replace);  // a reason may quote what came over the network
}

Result<DriftAlert> parse_alert(std::string_view text) {
  try {
    const json in = json::parse(text);
    DriftAlert alert;
    alert.alert_sequence = integer_from<std::uint64_t>(in.at("alert_sequence"));
    alert.stamp = parse_rfc3339(in.at("stamp").get<std::string>()).value();
    alert.vehicle = in.at("vehicle").get<std::string>();
    alert.pair = in.at("pair").get<std::string>();
    alert.verdict = parse_verdict(in.at("verdict").get<std::string>()).value();
    alert.previous_verdict = parse_verdict(in.at("previous_verdict").get<std::string>()).value();
    alert.reason = in.at("reason").get<std::string>();
    alert.misalignment.delta = six(in.at("rotation_rad"), in.at("translation_m"));
    alert.misalignment.sigma = six(in.at("sigma_rotation_rad"), in.at("sigma_translation_m"));
    alert.record_sequence = integer_from<std::uint64_t>(in.at("record_sequence"));
    return alert;
  } catch (const std::exception& exception) {
    return fail(ErrorCode::malformed_alert, std::string("a kept alert cannot be read: ") + exception.what());
  }
}

}  // namespace calib
