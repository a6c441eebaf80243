#include <fmt/format.h>

#include "baseline_record.hpp"
#include "message_ids.hpp"
#include "pair_pipeline.hpp"

namespace calib {

/// Makes the record's extrinsic the one in force. What was learned belonged to the one before; of an extrinsic that was
/// in force earlier the baseline is known.
PairDecision PairPipeline::put_in_force(CalibrationRecord record, const PairState& before, PairState after,
                                        const Now& now) const {
  PairDecision decision;
  const bool accepted = record.decision == Decision::accepted;
  const PairState evidence = after;
  const CalibrationRecord* baseline = accepted ? nullptr : now.history.baseline(record.T_camera_lidar);
  after.drift = baseline != nullptr && baseline->evidence_sha256 == settings_.evidence_sha256
                    ? learned_state(*baseline->baseline)
                    : DriftState{};
  after.set({Verdict::not_evaluated, ErrorCode::no_pair_yet,
             fmt::format("no pair was evaluated yet at the extrinsic of record {}", now.next_sequence)});
  after.run.optimum.reset();
  after.run.searched_at.reset();
  after.score.reset();
  after.proposed_record.reset();
  after.unresolved.reset();
  after.probation = accepted ? std::optional<Probation>(std::in_place) : std::nullopt;
  after.run.pairs = 0;
  after.run.frames.clear();
  decision.state = std::move(after);
  finish(decision, before, evidence, now);
  decision.journal.push_back({5, accepted ? message_ids::recalibration_accepted : message_ids::rolled_back,
                              fmt::format("{}: {} extrinsic in force by record {}: {}", settings_.pair,
                                          accepted ? "new" : "earlier", now.next_sequence, record.reason),
                              fields(*decision.state, now.next_sequence)});
  decision.answer = Answer{.decision = record.decision, .reason = record.reason, .record = now.next_sequence};
  decision.record = std::move(record);
  return decision;
}

/// Back to the extrinsic before the one on probation.
PairDecision PairPipeline::end_probation(const PairState& before, PairState after, const std::string& why,
                                         const Now& now) const {
  const CalibrationRecord& on_probation = *now.history.in_force();
  CalibrationRecord record = new_record(
      Decision::rolled_back, after, "calibd",
      fmt::format("the extrinsic of record {} has not passed its probation: {}", on_probation.sequence, why));
  record.T_camera_lidar = on_probation.T_camera_lidar_before;
  count_refusal(after);
  return put_in_force(std::move(record), before, std::move(after), now);
}

PairDecision PairPipeline::decide(const PairState& state, const Accept& request, const Now& now) const {
  PairDecision decision;
  if (!request.proposal) {
    decision.answer = fail(ErrorCode::not_found, "no proposal waits for an answer");
    return decision;
  }
  CalibrationRecord record = *request.proposal;
  record.decision = Decision::accepted;
  record.asked_by = request.asked_by;
  record.comment = request.comment;
  record.reason = fmt::format("proposal of record {} accepted", request.proposal->sequence);
  record.evidence_sha256 = settings_.evidence_sha256;
  record.T_camera_lidar_before = state.T_camera_lidar;
  return put_in_force(std::move(record), state, state, now);
}

PairDecision PairPipeline::decide(const PairState& state, const RollBack& request, const Now& now) const {
  PairDecision decision;
  if (!request.target) {
    decision.answer = fail(ErrorCode::not_found, "there is no earlier extrinsic to go back to");
    return decision;
  }
  const CalibrationRecord& target = *request.target;
  if (!puts_in_force(target.decision)) {
    decision.answer = fail(ErrorCode::bad_request,
                           fmt::format("record {} put nothing in force, it is {}; name an initial, accepted or "
                                       "rolled_back one",
                                       target.sequence, to_string(target.decision)));
    return decision;
  }
  CalibrationRecord record = new_record(Decision::rolled_back, state, request.asked_by,
                                        fmt::format("back to the extrinsic of record {}", target.sequence));
  record.comment = request.comment;
  record.T_camera_lidar = target.T_camera_lidar;
  record.sigma = target.sigma;
  PairState after = state;
  after.refusals = 0;
  after.retry_at = 0;
  return put_in_force(std::move(record), state, std::move(after), now);
}

}  // namespace calib
