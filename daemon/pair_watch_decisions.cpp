#include "control.hpp"
#include "message_ids.hpp"
#include "pair_watch.hpp"

namespace calib {
namespace {

using nlohmann::json;

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

}  // namespace

json PairWatch::recalibrate(const std::string& asked_by, bool dry_run) {
  const auto outcome = monitor_.recalibrate();
  if (!outcome) return refusal(outcome.error().code == "not_ready" ? "not_ready" : "failed", outcome.error().context);
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
  if (record.decision == Decision::accepted) {
    json put = put_in_force(std::move(record));
    put["result"] = reply["result"];
    return put;
  }
  PairState after = state_;
  const std::uint64_t sequence = ledger_.next_sequence();
  const bool proposed = record.decision == Decision::proposed;
  if (proposed)
    after.proposed_record = sequence;
  else
    ++after.refusals;
  if (!write(std::move(after), std::move(record)))
    return refusal("failed", "the record could not be written; see the journal");
  reply["answer"] = proposed ? "proposed" : "rejected";
  reply["record"] = sequence;
  listener_.journal(5, proposed ? message_ids::recalibration_proposed : message_ids::recalibration_rejected,
                    name() + ": recalibration " + reply["answer"].get<std::string>() + " in record " +
                        number(sequence) + ": " + result.reason);
  if (proposed) listener_.extrinsic_changed();
  // The same pairs would give the same answer: wait for new ones, twice as long each time.
  monitor_.forget_pairs();
  retry_at_ = state_.evaluated + (std::uint64_t{monitor_.wanted_pairs()} << std::min(state_.refusals, 8));
  return reply;
}

/// Makes the record's extrinsic the one in force; what was learned belonged to the old one.
json PairWatch::put_in_force(CalibrationRecord record) {
  const Decision decision = record.decision;
  const std::string reason = record.reason;
  PairState after = state_;
  after.drift = {};
  after.verdict = Verdict::not_evaluated;
  after.reason = DriftMonitor(monitor_.drift().settings()).reason();
  after.score.reset();
  after.proposed_record.reset();
  after.refusals = 0;
  const std::uint64_t sequence = ledger_.next_sequence();
  if (!write(std::move(after), std::move(record)))
    return refusal("failed", "the record could not be written; see the journal");
  monitor_.adopt(ledger_.in_force(name())->T_camera_lidar);
  retry_at_ = 0;
  const bool accepted = decision == Decision::accepted;
  listener_.journal(5, accepted ? message_ids::recalibration_accepted : message_ids::rolled_back,
                    name() + ": " + (accepted ? "new extrinsic" : "earlier extrinsic") + " in force by record " +
                        number(sequence) + ": " + reason);
  listener_.extrinsic_changed();
  return {{"ok", true}, {"answer", accepted ? "accepted" : "rolled_back"}, {"reason", reason}, {"record", sequence}};
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
  return put_in_force(std::move(record));
}

json PairWatch::roll_back(const json& to, const std::string& asked_by) {
  const CalibrationRecord* before = ledger_.before_in_force(name());
  if (to.is_null() && before == nullptr) return refusal("not_found", "there is no earlier extrinsic to go back to");
  if (!to.is_null() && !to.is_number_unsigned()) return refusal("bad_request", "\"to\" is a record's number or null");
  const std::uint64_t target = to.is_null() ? before->sequence : to.get<std::uint64_t>();
  const auto earlier = ledger_.find(name(), target);
  if (!earlier)
    return refusal(earlier.error().code == "record_not_found" ? "not_found" : "failed", earlier.error().context);
  if (earlier->decision == Decision::rejected)
    return refusal("bad_request", "record " + number(target) + " was rejected; only what was in force can be again");
  CalibrationRecord record;
  record.decision = Decision::rolled_back;
  record.asked_by = asked_by;
  record.reason = "back to the extrinsic of record " + number(target);
  record.T_camera_lidar = earlier->T_camera_lidar;
  record.T_camera_lidar_before = monitor_.T_camera_lidar();
  record.sigma = earlier->sigma;
  return put_in_force(std::move(record));
}

}  // namespace calib
