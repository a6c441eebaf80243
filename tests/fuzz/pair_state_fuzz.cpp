#include "pair_state.hpp"

#include "fuzz/fuzz.hpp"

namespace calib::fuzz {

std::vector<Octets> seeds() {
  PairState state;
  state.verdict = Verdict::suspect;
  state.reason = "yaw: 0.6 degrees";
  state.since = std::chrono::seconds(1'700'000'000);
  state.last_evaluated = state.recalibrated = state.since;
  state.evaluated = 30;
  state.skipped = {{"low_overlap", 3}};
  state.score = PairStatus::Score{0.2, 0.19, 0.21};
  state.last_stamp = std::chrono::seconds(12);
  state.proposed_record = 4;
  state.probation = Probation{3, 0.01, 0.001};
  AxisEvidence evidence;
  evidence.stamp = std::chrono::seconds(11);
  state.drift.recent.push_back(evidence);
  evidence.sensitivity = Matrix6::Identity();
  state.drift.recent.push_back(evidence);
  state.drift.baseline.pairs = 20;
  return {octets(to_text(PairState{})), octets(to_text(state))};
}

}  // namespace calib::fuzz

/// What is taken has a form of its own, which is taken as it is.
int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t size) {
  const auto state = calib::parse_pair_state(calib::fuzz::text(bytes, size));
  if (!state) {
    calib::fuzz::require_code(state.error(), {calib::ErrorCode::malformed_state});
    return 0;
  }
  calib::fuzz::require(state->refusals >= 0 && state->drift.baseline.pairs >= 0);
  calib::fuzz::require(!state->probation || state->probation->pairs >= 0);
  const std::string text = calib::to_text(*state);
  const auto again = calib::parse_pair_state(text);
  calib::fuzz::require(again.has_value() && calib::to_text(*again) == text);
  return 0;
}
