#include "pair_state.hpp"

#include <nlohmann/json.hpp>

namespace calib {
namespace {

using nlohmann::json;

template <typename Vector>
json numbers(const Vector& vector) {
  json array = json::array();
  for (const auto& value : vector) array.push_back(value);
  return array;
}

Vector6 vector6(const json& array) {
  const auto values = array.get<std::array<double, 6>>();
  return Vector6::Map(values.data());
}

json stamps(const std::array<Timestamp, 6>& values) {
  json array = json::array();
  for (Timestamp value : values) array.push_back(value.count());
  return array;
}

std::array<Timestamp, 6> stamps_from(const json& array) {
  const auto counts = array.get<std::array<std::int64_t, 6>>();
  std::array<Timestamp, 6> values;
  for (std::size_t i = 0; i < values.size(); ++i) values[i] = Timestamp(counts[i]);
  return values;
}

template <typename Value, typename Write>
json optional(const std::optional<Value>& value, Write write) {
  return value ? write(*value) : json();
}

DriftVerdict drift_verdict(int number) {
  if (number < 0 || number > static_cast<int>(DriftVerdict::drifted)) throw std::invalid_argument("drift verdict");
  return static_cast<DriftVerdict>(number);
}

json evidence_json(const AxisEvidence& evidence) {
  return {{"stamp_ns", evidence.stamp.count()},
          {"slope", numbers(evidence.slope)},
          {"curvature", numbers(evidence.curvature)},
          {"score", evidence.score}};
}

AxisEvidence evidence_from(const json& in) {
  return {Timestamp(in.at("stamp_ns").get<std::int64_t>()), vector6(in.at("slope")), vector6(in.at("curvature")),
          in.at("score").get<double>()};
}

json drift_json(const DriftState& drift) {
  json recent = json::array();
  for (const AxisEvidence& evidence : drift.recent) recent.push_back(evidence_json(evidence));
  const DriftBaseline& baseline = drift.baseline;
  return {{"recent", recent},
          {"baseline",
           {{"pairs", baseline.pairs},
            {"slope", numbers(baseline.slope)},
            {"slope_squares", numbers(baseline.slope_squares)},
            {"curvature", numbers(baseline.curvature)},
            {"curvature_squares", numbers(baseline.curvature_squares)},
            {"score", baseline.score}}},
          {"cusum_up", numbers(drift.cusum_up)},
          {"cusum_down", numbers(drift.cusum_down)},
          {"up_since_ns", stamps(drift.up_since)},
          {"down_since_ns", stamps(drift.down_since)},
          {"verdict", static_cast<int>(drift.verdict)}};
}

DriftState drift_from(const json& in) {
  DriftState drift;
  for (const json& evidence : in.at("recent")) drift.recent.push_back(evidence_from(evidence));
  const json& baseline = in.at("baseline");
  drift.baseline = {baseline.at("pairs").get<int>(),           vector6(baseline.at("slope")),
                    vector6(baseline.at("slope_squares")),     vector6(baseline.at("curvature")),
                    vector6(baseline.at("curvature_squares")), baseline.at("score").get<double>()};
  if (drift.baseline.pairs < 0) throw std::invalid_argument("baseline pairs");
  drift.cusum_up = vector6(in.at("cusum_up"));
  drift.cusum_down = vector6(in.at("cusum_down"));
  drift.up_since = stamps_from(in.at("up_since_ns"));
  drift.down_since = stamps_from(in.at("down_since_ns"));
  drift.verdict = drift_verdict(in.at("verdict").get<int>());
  return drift;
}

json score_json(const PairStatus::Score& score) {
  return {{"current", score.current},
          {"best_neighbour", score.best_neighbour},
          {"baseline", optional(score.baseline, [](double v) { return json(v); })}};
}

PairStatus::Score score_from(const json& in) {
  PairStatus::Score score{in.at("current").get<double>(), in.at("best_neighbour").get<double>(), {}};
  if (!in.at("baseline").is_null()) score.baseline = in.at("baseline").get<double>();
  return score;
}

}  // namespace

std::string to_text(const PairState& state) {
  return json{{"schema", 1},
              {"drift", drift_json(state.drift)},
              {"verdict", to_string(state.verdict)},
              {"reason", state.reason},
              {"since_ns", state.since.count()},
              {"last_evaluated_ns", optional(state.last_evaluated, [](WallTime t) { return json(t.count()); })},
              {"evaluated", state.evaluated},
              {"skipped", state.skipped},
              {"score", optional(state.score, score_json)},
              {"last_stamp_ns", state.last_stamp.count()},
              {"proposed_record", optional(state.proposed_record, [](std::uint64_t n) { return json(n); })},
              {"refusals", state.refusals}}
      .dump(-1, ' ', false, json::error_handler_t::replace);  // a reason may quote what came over the network
}

Result<PairState> parse_pair_state(std::string_view text) {
  try {
    const json in = json::parse(text);
    if (in.at("schema") != 1) return fail("malformed_state", "the saved state is of another version");
    PairState state;
    state.drift = drift_from(in.at("drift"));
    const auto verdict = parse_verdict(in.at("verdict").get<std::string>());
    if (!verdict) return tl::unexpected(verdict.error());
    state.verdict = *verdict;
    state.reason = in.at("reason").get<std::string>();
    state.since = WallTime(in.at("since_ns").get<std::int64_t>());
    if (!in.at("last_evaluated_ns").is_null())
      state.last_evaluated = WallTime(in.at("last_evaluated_ns").get<std::int64_t>());
    state.evaluated = in.at("evaluated").get<std::uint64_t>();
    state.skipped = in.at("skipped").get<std::map<std::string, std::uint64_t>>();
    if (!in.at("score").is_null()) state.score = score_from(in.at("score"));
    state.last_stamp = Timestamp(in.at("last_stamp_ns").get<std::int64_t>());
    if (!in.at("proposed_record").is_null()) state.proposed_record = in.at("proposed_record").get<std::uint64_t>();
    state.refusals = in.at("refusals").get<int>();
    return state;
  } catch (const std::exception& exception) {
    return fail("malformed_state", std::string("the saved state cannot be read: ") + exception.what());
  }
}

}  // namespace calib
