#include "dds/messages.hpp"
#include "fuzz/fuzz.hpp"

namespace calib::fuzz {

std::vector<Octets> seeds() {
  return {
      octets(R"({"alert_sequence":7,"pair":"front","previous_verdict":"calibrated","reason":"yaw: 0.6 degrees",)"
             R"("record_sequence":3,"rotation_rad":[0.0,0.0,0.01],"schema":1,"sigma_rotation_rad":[0.001,0.001,0.001],)"
             R"("sigma_translation_m":[0.01,0.01,0.01],"stamp":"2026-01-31T12:00:00.000000001Z",)"
             R"("translation_m":[0.0,0.0,0.0],"vehicle":"demo-car","verdict":"drifted"})")};
}

}  // namespace calib::fuzz

/// What is taken can be sent.
int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t size) {
  const auto alert = calib::parse_alert(calib::fuzz::text(bytes, size));
  if (!alert) {
    calib::fuzz::require_code(alert.error(), {calib::ErrorCode::malformed_alert});
    return 0;
  }
  const auto message = calib::drift_alert_message(*alert);
  calib::fuzz::require(message->alert_sequence == alert->alert_sequence && message->vehicle != nullptr);
  calib::fuzz::require(message->verdict == calib::to_string(alert->verdict));
  return 0;
}
