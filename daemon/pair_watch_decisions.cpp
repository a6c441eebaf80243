#include <cstdio>

#include "baseline_record.hpp"
#include "control.hpp"
#include "message_ids.hpp"
#include "pair_watch.hpp"

namespace calib {
namespace {

using nlohmann::json;

/// An extrinsic on probation that does worse than the one it replaced is given up early, when that is sure; at the end
/// it has to do better.
constexpr int least_probation_pairs = 5;
constexpr double surely_worse_sigmas = 3, better_sigmas = 2;
/// Waiting is doubled no further: a day or two at the default interval.
constexpr int most_doublings = 8;

json vector3(const Eigen::Vector3d& v) { return {v.x(), v.y(), v.z()}; }

json in_json(const Recalibration& result) {
  return {{"T_camera_lidar", transform_json(result.T_camera_lidar)},
          {"change",
           {{"rotation_deg", vector3(result.delta.head<3>() / radians_per_degree)},
            {"translation_cm", vector3(result.delta.tail<3>() * 100)}}},
          {"score",
           {{"before", result.score_before},
            {"after", result.score_after},
            {"held_back_before", result.held_back_before},
            {"held_back_after", result.held_back_after}}}};
}

std::string number(std::uint64_t value) { return std::to_string(value); }

std::string in_words(const Probation& probation) {
  char text[160];
  std::snprintf(text, sizeof text, "over %d pairs the score is %.4f +/- %.4f %s that of the extrinsic before",
                probation.pairs, std::abs(probation.gain), probation.standard_error(),
                probation.gain < 0 ? "below" : "above");
  return text;
}

}  // namespace

/// Whether it is time for a recalibration that nobody asked for. A clock that was set back does not hold it up.
bool PairWatch::may_recalibrate() const {
  if (state_.evaluated < state_.retry_at) return false;
  if (!state_.recalibrated) return true;
  const auto since = clock_().wall - *state_.recalibrated;
  return since < since.zero() ||
         since >= pair_.recalibration.min_interval * (1 << std::min(state_.refusals, most_doublings));
}

/// What a recalibration that is wanted waits for.
std::string PairWatch::patience() const {
  if (may_recalibrate()) return "";
  if (state_.evaluated < state_.retry_at)
    return "; the next is tried after " + number(state_.retry_at - state_.evaluated) + " more pairs";
  const auto wait = pair_.recalibration.min_interval * (1 << std::min(state_.refusals, most_doublings));
  return "; the next is tried not before " + rfc3339(*state_.recalibrated + wait);
}

/// The same pairs would give the same answer: wait for new ones, twice as long each time.
void PairWatch::refuse(PairState& after) const {
  ++after.refusals;
  after.retry_at =
      after.evaluated + (std::uint64_t{monitor_.wanted_pairs()} << std::min(after.refusals, most_doublings));
}

/// Memory that runs out, and what a library throws, cost the recalibration and no more.
Result<PairMonitor::Outcome> PairWatch::try_to_recalibrate() const try {
  return monitor_.recalibrate(listener_.keep_going);
} catch (const std::exception& exception) {
  return fail(ErrorCode::recalibration_failed, std::string("the recalibration was broken off: ") + exception.what());
}

json PairWatch::recalibrate(const std::string& asked_by, bool dry_run) {
  const auto outcome = try_to_recalibrate();
  if (!outcome && outcome.error().code == ErrorCode::recalibration_failed) count_skipped(outcome.error().code);
  if (!outcome)
    return refusal(outcome.error().code == ErrorCode::not_ready ? "not_ready" : "failed", outcome.error().context);
  const Recalibration& result = outcome->result;
  json reply{{"ok", true}, {"reason", result.reason}, {"record", nullptr}, {"result", in_json(result)}};
  if (dry_run) {
    reply["answer"] = "dry_run";
    reply["would"] = result.accepted ? "accepted" : "rejected";
    return reply;
  }
  CalibrationRecord record;
  const bool apply = pair_.recalibration.mode == RecalibrationMode::apply;
  record.decision = !result.accepted ? Decision::rejected : apply ? Decision::accepted : Decision::proposed;
  record.asked_by = asked_by;
  record.reason = result.reason;
  record.T_camera_lidar = result.T_camera_lidar;
  record.T_camera_lidar_before = monitor_.T_camera_lidar();
  record.sigma = result.sigma;
  record.score = CalibrationRecord::Score{result.score_before, result.score_after, result.held_back_before,
                                          result.held_back_after};
  for (Timestamp stamp : outcome->frames) record.frame_stamps_ns.push_back(stamp.count());
  PairState after = state_;
  after.recalibrated = clock_().wall;
  if (record.decision == Decision::accepted) {
    json put = put_in_force(std::move(record), std::move(after));
    put["result"] = reply["result"];
    return put;
  }
  const std::uint64_t sequence = ledger_.next_sequence();
  const bool proposed = record.decision == Decision::proposed;
  if (proposed)
    after.proposed_record = sequence;
  else
    refuse(after);
  if (!write(std::move(after), std::move(record)))
    return refusal("failed", "the record could not be written; see the journal");
  reply["answer"] = proposed ? "proposed" : "rejected";
  reply["record"] = sequence;
  listener_.journal(5, proposed ? message_ids::recalibration_proposed : message_ids::recalibration_rejected,
                    name() + ": recalibration " + reply["answer"].get<std::string>() + " in record " +
                        number(sequence) + ": " + result.reason);
  if (proposed) listener_.extrinsic_changed();
  monitor_.forget_pairs();
  return reply;
}

/// Makes the record's extrinsic the one in force. What was learned belonged to the one before; of an extrinsic that was
/// in force earlier the baseline is known.
json PairWatch::put_in_force(CalibrationRecord record, PairState after) {
  const bool accepted = record.decision == Decision::accepted;
  const std::string reason = record.reason;
  const CalibrationRecord* baseline = accepted ? nullptr : ledger_.baseline(name(), record.T_camera_lidar);
  after.drift = baseline != nullptr && baseline->evidence_sha256 == evidence_sha256_
                    ? learned_state(*baseline->baseline)
                    : DriftState{};
  after.verdict = Verdict::not_evaluated;
  after.reason = "no pair was evaluated yet at the extrinsic of record " + number(ledger_.next_sequence());
  after.score.reset();
  after.proposed_record.reset();
  after.unresolved.reset();
  after.probation = accepted ? std::optional<Probation>(std::in_place) : std::nullopt;
  const std::uint64_t sequence = ledger_.next_sequence();
  const DriftState drift = after.drift;
  const auto adopt = [&] {
    monitor_.adopt(ledger_.in_force(name())->T_camera_lidar, drift);
    pairs_ = 0;
  };
  if (!write(std::move(after), std::move(record), adopt))
    return refusal("failed", "the record could not be written; see the journal");
  listener_.journal(5, accepted ? message_ids::recalibration_accepted : message_ids::rolled_back,
                    name() + ": " + (accepted ? "new extrinsic" : "earlier extrinsic") + " in force by record " +
                        number(sequence) + ": " + reason);
  listener_.extrinsic_changed();
  return {{"ok", true}, {"answer", accepted ? "accepted" : "rolled_back"}, {"reason", reason}, {"record", sequence}};
}

/// Pair by pair, the extrinsic in force against the one that it replaced. False: it was, and another is.
bool PairWatch::stands_probation() {
  const Probation probation = *state_.probation;
  const bool over = probation.pairs >= pair_.drift.baseline_pairs;
  if (probation.pairs < least_probation_pairs) return true;
  if (probation.exceeds(-surely_worse_sigmas) || (over && !probation.exceeds(better_sigmas))) {
    return_from_probation((over ? "not surely better: " : "surely worse: ") + in_words(probation));
    return false;
  }
  if (!over) return true;
  state_.probation.reset();
  state_.refusals = 0;
  listener_.journal(5, message_ids::probation_passed,
                    name() + ": the extrinsic of record " + number(ledger_.in_force(name())->sequence) +
                        " has stood its probation: " + in_words(probation));
  return true;
}

void PairWatch::return_from_probation(const std::string& why) {
  const CalibrationRecord& on_probation = *ledger_.in_force(name());
  CalibrationRecord record;
  record.decision = Decision::rolled_back;
  record.asked_by = "calibd";
  record.reason = "the extrinsic of record " + number(on_probation.sequence) + " has not stood its probation: " + why;
  record.T_camera_lidar = on_probation.T_camera_lidar_before;
  record.T_camera_lidar_before = on_probation.T_camera_lidar;
  PairState after = state_;
  refuse(after);
  [[maybe_unused]] const json told = put_in_force(std::move(record), std::move(after));
}

json PairWatch::accept(const std::string& asked_by) {
  if (!state_.proposed_record) return refusal("not_found", "no proposal waits for an answer");
  const auto proposal = ledger_.find(name(), *state_.proposed_record);
  if (!proposal) return refusal("failed", proposal.error().context);
  CalibrationRecord record = *proposal;
  record.decision = Decision::accepted;
  record.asked_by = asked_by;
  record.reason = "proposal of record " + number(proposal->sequence) + " accepted";
  record.T_camera_lidar_before = monitor_.T_camera_lidar();
  return put_in_force(std::move(record), state_);
}

json PairWatch::roll_back(const json& to, const std::string& asked_by) {
  const CalibrationRecord* before = ledger_.before_in_force(name());
  if (to.is_null() && before == nullptr) return refusal("not_found", "there is no earlier extrinsic to go back to");
  if (!to.is_null() && !to.is_number_unsigned()) return refusal("bad_request", "\"to\" is a record's number or null");
  const std::uint64_t target = to.is_null() ? before->sequence : to.get<std::uint64_t>();
  const auto earlier = ledger_.find(name(), target);
  if (!earlier)
    return refusal(earlier.error().code == ErrorCode::record_not_found ? "not_found" : "failed",
                   earlier.error().context);
  if (!puts_in_force(earlier->decision))
    return refusal("bad_request", "record " + number(target) + " put nothing in force, it is " +
                                      std::string(to_string(earlier->decision)) +
                                      "; name an initial, accepted or rolled_back one");
  CalibrationRecord record;
  record.decision = Decision::rolled_back;
  record.asked_by = asked_by;
  record.reason = "back to the extrinsic of record " + number(target);
  record.T_camera_lidar = earlier->T_camera_lidar;
  record.T_camera_lidar_before = monitor_.T_camera_lidar();
  record.sigma = earlier->sigma;
  PairState after = state_;
  after.refusals = 0;
  after.retry_at = 0;
  return put_in_force(std::move(record), std::move(after));
}

}  // namespace calib
