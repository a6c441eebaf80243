#include "pair_state.hpp"

#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>

#include "support/catch.hpp"
#include "support/support.hpp"
#include "vehicle/random.hpp"

using namespace calib;
using namespace std::chrono_literals;

namespace {

AxisEvidence random_evidence(vehicle::Random& random, Timestamp stamp, double shift = 0) {
  AxisEvidence evidence{.stamp = stamp,
                        .score = 1.2 + 0.01 * random.gaussian(),
                        .prominence = 0.02 + 0.005 * random.gaussian(),
                        .sensitivity = Matrix6::Zero()};
  for (int i = 0; i < 36; ++i) (*evidence.sensitivity)(i / 6, i % 6) = (i % 7 == 0) + 0.1 * random.gaussian();
  for (int axis = 0; axis < 6; ++axis) evidence.slope[axis] = shift + 0.1 * random.gaussian();
  return evidence;
}

PairState full_state() {
  vehicle::Random random(1);
  DriftMonitor monitor({});
  for (int i = 0; i < 45; ++i) monitor.observe(random_evidence(random, 1s * i, i < 40 ? 0 : 0.6));
  PairState state;
  state.drift = monitor.state();
  state.set({Verdict::suspect, std::nullopt, "a reason"});
  state.reason = "the LiDAR seems to have moved: \"yaw\"\n\xc3\xa4";
  state.unresolved = "it was drifted";
  state.since = WallTime(1'700'000'000'123'456'789);
  state.last_evaluated = WallTime(1'700'000'001'000'000'001);
  state.evaluated = 18'000'000'000'000'000'000U;
  state.skipped = {{"dark", 3}, {"low_overlap", 1}};
  state.score = PairStatus::Score{1.2345678901234567, 1.1, 0.1 + 0.2};
  state.last_stamp = Timestamp(-5);
  state.proposed_record = 7;
  state.probation = Probation{3, -0.25, 1e-7};
  state.refusals = 2;
  state.retry_at = 17'000'000'000'000'000'000U;
  state.recalibrated = WallTime(1'700'000'000'999'999'999);
  return state;
}

nlohmann::json as_json(const PairState& state) { return nlohmann::json::parse(to_text(state)); }

}  // namespace

TEST_CASE("a monitor that goes on from its text sees, to the last bit, what it would have seen without the restart") {
  vehicle::Random random(2);
  DriftMonitor straight({}), restarted({});
  for (int i = 0; i < 150; ++i) {
    const AxisEvidence evidence = random_evidence(random, 1s * i, i < 120 ? 0 : 0.6);
    CHECK(test::require_ok(straight.observe(evidence)) == test::require_ok(restarted.observe(evidence)));
    PairState state;
    state.drift = restarted.state();
    restarted = DriftMonitor({}, test::require_ok(parse_pair_state(to_text(state))).drift);
    PairState of_straight;
    of_straight.drift = straight.state();
    REQUIRE(to_text(state) == to_text(of_straight));
  }
  CHECK(straight.verdict() == DriftVerdict::drifted);
  REQUIRE(restarted.misalignment());
  CHECK(restarted.misalignment()->delta == straight.misalignment()->delta);
  CHECK(restarted.onset() == straight.onset());
}

TEST_CASE("a state that is written and read is the same, with and without what is optional") {
  for (const PairState& state : {PairState{}, full_state()}) {
    const PairState read = test::require_ok(parse_pair_state(to_text(state)));
    CHECK(to_text(read) == to_text(state));
    CHECK(read.verdict == state.verdict);
    CHECK(read.reason == state.reason);
    CHECK(read.since == state.since);
    CHECK(read.last_evaluated == state.last_evaluated);
    CHECK(read.evaluated == state.evaluated);
    CHECK(read.skipped == state.skipped);
    CHECK(read.last_stamp == state.last_stamp);
    CHECK(read.proposed_record == state.proposed_record);
    REQUIRE(read.probation.has_value() == state.probation.has_value());
    if (state.probation) {
      CHECK(read.probation->pairs == state.probation->pairs);
      CHECK(read.probation->gain == state.probation->gain);
      CHECK(read.probation->gain_squares == state.probation->gain_squares);
    }
    CHECK(read.refusals == state.refusals);
    CHECK(read.retry_at == state.retry_at);
    CHECK(read.recalibrated == state.recalibrated);
    REQUIRE(read.score.has_value() == state.score.has_value());
    if (state.score) {
      CHECK(read.score->current == state.score->current);
      CHECK(read.score->baseline == state.score->baseline);
    }
    CHECK(read.drift.charts == state.drift.charts);
    CHECK(read.drift.loss_charts == state.drift.loss_charts);
    CHECK(read.drift.baseline.slope_products == state.drift.baseline.slope_products);
  }
}

TEST_CASE("a state that lacks any of its fields, or has one of another kind, is refused as a whole") {
  const nlohmann::json whole = as_json(full_state());
  const auto refused = [](const nlohmann::json& changed) {
    const auto state = parse_pair_state(changed.dump());
    INFO(changed.dump());
    REQUIRE_FALSE(state);
    CHECK_FALSE(state.error().context.empty());
  };
  const nlohmann::json flat = whole.flatten();
  for (const auto& [path, value] : flat.items()) {
    const nlohmann::json::json_pointer pointer(path);
    nlohmann::json changed = whole;
    changed[pointer] = nlohmann::json::array({"no"});
    refused(changed);
    const bool in_array = pointer.back().find_first_not_of("0123456789") == std::string::npos;
    if (!in_array && pointer.parent_pointer().to_string() != "/skipped") {
      changed = whole;
      changed[pointer.parent_pointer()].erase(pointer.back());
      refused(changed);
    }
  }
}

TEST_CASE("numbers that no monitor can have are refused: what is saved must not make the daemon misbehave") {
  const nlohmann::json whole = as_json(full_state());
  const auto code = [&](const char* path, const nlohmann::json& value) {
    nlohmann::json changed = whole;
    changed[nlohmann::json::json_pointer(path)] = value;
    const auto state = parse_pair_state(changed.dump());
    return state ? "" : word(state.error().code);
  };
  CHECK(code("/drift/verdict", 5) == "malformed_state");
  CHECK(code("/drift/verdict", -1) == "malformed_state");
  CHECK(code("/drift/baseline/pairs", -3) == "malformed_state");
  CHECK(code("/drift/baseline/slope", {1, 2, 3, 4, 5}) == "malformed_state");
  CHECK(code("/drift/baseline/score", std::numeric_limits<double>::quiet_NaN()) == "malformed_state");
  CHECK(code("/probation/pairs", -1) == "malformed_state");
  CHECK(code("/probation/gain_squares", -1.0) == "malformed_state");
  CHECK(code("/refusals", -1) == "malformed_state");
  CHECK(code("/verdict", "fine") == "malformed_state");
  CHECK(code("/cause", "stale") == "malformed_state");  // of a verdict
  CHECK(code("/cause", "no such word") == "");          // of a later calibd: the verdict has none
  CHECK(code("/schema", 1) == "malformed_state");
  // Drifted while still learning, by no evidence at all.
  nlohmann::json hollow = whole;
  hollow["drift"] = as_json(PairState{})["drift"];
  hollow["drift"]["verdict"] = static_cast<int>(DriftVerdict::drifted);
  CHECK(DriftMonitor({}, test::require_ok(parse_pair_state(hollow.dump())).drift).onset() == Timestamp::min());
}

TEST_CASE("a reason that quotes a broken message is written all the same") {
  PairState state;
  state.reason = "malformed:encoding: encoding '\xff\x80rgb8' is not supported";
  CHECK_THAT(test::require_ok(parse_pair_state(to_text(state))).reason, Catch::Matchers::ContainsSubstring("rgb8"));
}

TEST_CASE("a probation knows how sure its gain is") {
  Probation probation;
  CHECK_FALSE(probation.exceeds(0));
  CHECK_FALSE(probation.exceeds(-3));
  for (const double gain : {1.0, 2.0, 3.0, 4.0}) probation.add(gain);
  CHECK(probation.gain == Approx(2.5));
  CHECK(probation.standard_error() == Approx(std::sqrt(5.0 / 3 / 4)));
  CHECK(probation.exceeds(3));
  CHECK_FALSE(probation.exceeds(4));
  CHECK_FALSE(probation.exceeds(-3));
  Probation worse;
  for (const double gain : {-1.0, -2.0, -3.0, -4.0}) worse.add(gain);
  CHECK(worse.exceeds(-3));
  CHECK_FALSE(worse.exceeds(-4));
}

TEST_CASE("text that is no state is refused") {
  const std::string text = to_text(full_state());
  for (const std::string& bad : {std::string(), std::string("null"), std::string("[]"), std::string("{}"),
                                 std::string("\xff\xfe"), std::string(100'000, '['), text + "x"})
    CHECK_FALSE(parse_pair_state(bad));
  for (std::size_t length = 0; length < text.size(); length += 11)
    REQUIRE_FALSE(parse_pair_state(text.substr(0, length)));
}
