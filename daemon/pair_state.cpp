#include "pair_state.hpp"

#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>

#include "calib/json_integer.hpp"

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

template <typename Value, typename Write>
json optional(const std::optional<Value>& value, Write write) {
  return value ? write(*value) : json();
}

DriftVerdict drift_verdict(int number) {
  if (number < 0 || number > static_cast<int>(DriftVerdict::drifted)) throw std::invalid_argument("drift verdict");
  return static_cast<DriftVerdict>(number);
}

Matrix6 matrix6(const json& array) {
  const auto values = array.get<std::array<double, 36>>();
  return Matrix6::Map(values.data());
}

json evidence_json(const AxisEvidence& evidence) {
  return {{"stamp_ns", evidence.stamp.count()},
          {"slope", numbers(evidence.slope)},
          {"score", evidence.score},
          {"peak", evidence.prominence},
          {"response", optional(evidence.sensitivity, [](const Matrix6& m) { return numbers(m.reshaped()); })}};
}

AxisEvidence evidence_from(const json& in) {
  AxisEvidence evidence{.stamp = Timestamp(integer_from<std::int64_t>(in.at("stamp_ns"))),
                        .slope = vector6(in.at("slope")),
                        .score = in.at("score").get<double>(),
                        .prominence = in.at("peak").get<double>()};
  if (!in.at("response").is_null()) evidence.sensitivity = matrix6(in.at("response"));
  return evidence;
}

json chart_json(const Cusum& chart) { return {{"sum", chart.sum}, {"since_ns", chart.onset.count()}}; }

Cusum chart_from(const json& in) {
  return {in.at("sum").get<double>(), Timestamp(integer_from<std::int64_t>(in.at("since_ns")))};
}

/// Calls `visit` with each chart of a state, in the order in which they are written.
template <typename State, typename Visit>
void for_each_chart(State& drift, Visit visit) {
  for (auto& [positive, negative] : drift.charts)
    for (auto* charts : {&positive, &negative})
      for (auto& chart : *charts) visit(chart);
  for (auto& chart : drift.loss_charts) visit(chart);
}

json baseline_json(const DriftBaseline& baseline) {
  return {{"pairs", baseline.pairs},
          {"responses", baseline.sensitivities},
          {"slope", numbers(baseline.slope)},
          {"slope_products", numbers(baseline.slope_products.reshaped())},
          {"latest_slope", numbers(baseline.latest_slope)},
          {"lagged_products", numbers(baseline.lag1_products)},
          {"response", numbers(baseline.sensitivity.reshaped())},
          {"response_squares", numbers(baseline.sensitivity_squares)},
          {"peak", baseline.prominence},
          {"peak_squares", baseline.prominence_squares},
          {"latest_peak", baseline.latest_prominence},
          {"lagged_peaks", baseline.lag1_prominences},
          {"score", baseline.score},
          {"score_squares", baseline.score_squares},
          {"batches", baseline.batches},
          {"batch_squares", numbers(baseline.batch_squares)}};
}

DriftBaseline baseline_from(const json& in) {
  const DriftBaseline baseline{.pairs = integer_from<int>(in.at("pairs")),
                               .sensitivities = integer_from<int>(in.at("responses")),
                               .slope = vector6(in.at("slope")),
                               .slope_products = matrix6(in.at("slope_products")),
                               .latest_slope = vector6(in.at("latest_slope")),
                               .lag1_products = vector6(in.at("lagged_products")),
                               .sensitivity = matrix6(in.at("response")),
                               .sensitivity_squares = vector6(in.at("response_squares")),
                               .prominence = in.at("peak").get<double>(),
                               .prominence_squares = in.at("peak_squares").get<double>(),
                               .latest_prominence = in.at("latest_peak").get<double>(),
                               .lag1_prominences = in.at("lagged_peaks").get<double>(),
                               .score = in.at("score").get<double>(),
                               .score_squares = in.at("score_squares").get<double>(),
                               .batches = integer_from<int>(in.at("batches")),
                               .batch_squares = vector6(in.at("batch_squares"))};
  constexpr int most = 1'000'000;
  const auto in_order = [](int count) { return count >= 0 && count <= most; };
  const bool squares = baseline.slope_products.diagonal().minCoeff() >= 0 &&
                       baseline.sensitivity_squares.minCoeff() >= 0 && baseline.batch_squares.minCoeff() >= 0 &&
                       baseline.prominence_squares >= 0 && baseline.score_squares >= 0;
  if (!in_order(baseline.pairs) || !in_order(baseline.sensitivities) || !in_order(baseline.batches) ||
      baseline.sensitivities > baseline.pairs || !squares)
    throw std::invalid_argument("a baseline");
  return baseline;
}

json drift_json(const DriftState& drift) {
  json recent = json::array(), charts = json::array();
  for (const AxisEvidence& evidence : drift.recent) recent.push_back(evidence_json(evidence));
  for_each_chart(drift, [&](const Cusum& chart) { charts.push_back(chart_json(chart)); });
  return {{"recent", recent},
          {"unlearned", drift.unlearned},
          {"repeats", drift.repeats},
          {"baseline", baseline_json(drift.baseline)},
          {"gathered", baseline_json(drift.gathered)},
          {"waiting", baseline_json(drift.waiting)},
          {"doubtful", baseline_json(drift.doubtful)},
          {"charts", charts},
          {"verdict", static_cast<int>(drift.verdict)}};
}

DriftState drift_from(const json& in) {
  DriftState drift;
  for (const json& evidence : in.at("recent")) drift.recent.push_back(evidence_from(evidence));
  drift.unlearned = integer_from<int>(in.at("unlearned"));
  drift.repeats = integer_from<int>(in.at("repeats"));
  if (drift.recent.size() > 24 || drift.unlearned < 0 || drift.unlearned > static_cast<int>(drift.recent.size()) ||
      drift.repeats < 0 || drift.repeats > 100)
    throw std::invalid_argument("recent pairs");
  drift.baseline = baseline_from(in.at("baseline"));
  drift.gathered = baseline_from(in.at("gathered"));
  drift.waiting = baseline_from(in.at("waiting"));
  drift.doubtful = baseline_from(in.at("doubtful"));
  std::size_t next = 0;
  for_each_chart(drift, [&](Cusum& chart) { chart = chart_from(in.at("charts").at(next++)); });
  drift.verdict = drift_verdict(integer_from<int>(in.at("verdict")));
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

json probation_json(const Probation& probation) {
  return {{"pairs", probation.pairs}, {"gain", probation.gain}, {"gain_squares", probation.gain_squares}};
}

Probation probation_from(const json& in) {
  const Probation probation{integer_from<int>(in.at("pairs")), in.at("gain").get<double>(),
                            in.at("gain_squares").get<double>()};
  if (probation.pairs < 0 || probation.gain_squares < 0) throw std::invalid_argument("probation");
  return probation;
}

json time_json(WallTime time) { return time.count(); }

std::optional<WallTime> time_from(const json& in) {
  return in.is_null() ? std::nullopt : std::optional(WallTime(integer_from<std::int64_t>(in)));
}

}  // namespace

void Probation::add(double pair_gain) {
  const double before = pair_gain - gain;
  gain += before / ++pairs;
  gain_squares += before * (pair_gain - gain);
}

double Probation::standard_error() const {
  return pairs < 2 ? std::numeric_limits<double>::infinity() : std::sqrt(gain_squares / (pairs - 1) / pairs);
}

bool Probation::exceeds(double sigmas) const {
  return sigmas < 0 ? gain < sigmas * standard_error() : gain > sigmas * standard_error();
}

std::string to_text(const PairState& state) {
  return json{{"schema", 5},
              {"drift", drift_json(state.drift)},
              {"evidence_sha256", state.evidence_sha256},
              {"unresolved", optional(state.unresolved, [](const std::string& why) { return json(why); })},
              {"verdict", to_string(state.verdict)},
              {"cause", optional(state.cause, [](ErrorCode cause) { return json(to_string(cause)); })},
              {"reason", state.reason},
              {"since_ns", state.since.count()},
              {"last_evaluated_ns", optional(state.last_evaluated, time_json)},
              {"evaluated", state.evaluated},
              {"skipped", state.skipped},
              {"score", optional(state.score, score_json)},
              {"last_stamp_ns", state.last_stamp.count()},
              {"proposed_record", optional(state.proposed_record, [](std::uint64_t n) { return json(n); })},
              {"probation", optional(state.probation, probation_json)},
              {"refusals", state.refusals},
              {"retry_at", state.retry_at},
              {"recalibrated_ns", optional(state.recalibrated, time_json)}}
      .dump(-1, ' ', false, json::error_handler_t::replace);  // a reason may quote what came over the network
}

Result<PairState> parse_pair_state(std::string_view text) {
  try {
    const json in = json::parse(text);
    if (in.at("schema") != 5) return fail(ErrorCode::malformed_state, "the saved state is of another version");
    PairState state;
    state.drift = drift_from(in.at("drift"));
    state.evidence_sha256 = in.at("evidence_sha256").get<std::string>();
    if (!in.at("unresolved").is_null()) state.unresolved = in.at("unresolved").get<std::string>();
    const auto verdict = parse_verdict(in.at("verdict").get<std::string>());
    if (!verdict) return fail(ErrorCode::malformed_state, "the saved state cannot be read: " + verdict.error().context);
    state.verdict = *verdict;
    state.cause.reset();
    if (!in.at("cause").is_null()) state.cause = parse_error_code(in.at("cause").get<std::string>());
    if ((state.verdict == Verdict::not_evaluated) != state.cause.has_value())
      return fail(ErrorCode::malformed_state, "the saved state has a cause that does not belong to its verdict");
    state.reason = in.at("reason").get<std::string>();
    state.since = WallTime(integer_from<std::int64_t>(in.at("since_ns")));
    state.last_evaluated = time_from(in.at("last_evaluated_ns"));
    state.evaluated = integer_from<std::uint64_t>(in.at("evaluated"));
    for (const auto& [reason, count] : in.at("skipped").get_ref<const json::object_t&>())
      state.skipped[reason] = integer_from<std::uint64_t>(count);
    if (!in.at("score").is_null()) state.score = score_from(in.at("score"));
    state.last_stamp = Timestamp(integer_from<std::int64_t>(in.at("last_stamp_ns")));
    if (!in.at("proposed_record").is_null())
      state.proposed_record = integer_from<std::uint64_t>(in.at("proposed_record"));
    if (!in.at("probation").is_null()) state.probation = probation_from(in.at("probation"));
    state.refusals = integer_from<int>(in.at("refusals"));
    if (state.refusals < 0)
      return fail(ErrorCode::malformed_state, "the saved state has a negative number of refusals");
    state.retry_at = integer_from<std::uint64_t>(in.at("retry_at"));
    state.recalibrated = time_from(in.at("recalibrated_ns"));
    return state;
  } catch (const std::exception& exception) {
    return fail(ErrorCode::malformed_state, std::string("the saved state cannot be read: ") + exception.what());
  }
}

}  // namespace calib
