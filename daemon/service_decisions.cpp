#include <limits>
#include <nlohmann/json.hpp>

#include "journal.hpp"
#include "message_ids.hpp"
#include "service.hpp"

namespace calib {
namespace {

using nlohmann::json;

/// As small a change of the configured extrinsic as can have come from rounding is none.
bool same(const RigidTransform& a, const RigidTransform& b) {
  const RigidTransform difference = a.inverse() * b;
  return rotation_angle_rad(difference) < 1e-9 && difference.translation().norm() < 1e-9;
}

PairMonitorSettings monitor_settings(const PairConfig& pair) {
  PairMonitorSettings settings;
  settings.frames = pair.recalibration.frames;
  settings.bounds = {pair.recalibration.max_rotation_rad, pair.recalibration.max_translation_m};
  settings.quality.depth_range = pair.depth_range;
  settings.drift.baseline_pairs = pair.drift.baseline_pairs;
  settings.depth_is_guessed = std::holds_alternative<OnnxDepthConfig>(pair.depth);
  if (settings.depth_is_guessed) {  // its own bias, before that is learned as what is normal
    settings.drift.max_bias_rotation_rad = radians_per_degree;
    settings.drift.max_bias_translation_m = std::numeric_limits<double>::infinity();
  }
  return settings;
}

PairTopics topics_of(const PairConfig& pair) {
  PairTopics topics{.image = pair.camera.image, .cloud = pair.lidar.cloud, .camera_info = pair.camera.info};
  if (const auto* stereo = std::get_if<StereoDepthConfig>(&pair.depth)) {
    topics.right_image = stereo->right_image;
    topics.right_camera_info = stereo->right_info;
  } else if (const auto* topic = std::get_if<TopicDepthConfig>(&pair.depth)) {
    topics.depth = topic->topic;
  } else {
    topics.colour = Colour::rgb;
  }
  return topics;
}

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

std::string_view message_id(const PairState& state) {
  switch (state.verdict) {
    case Verdict::drifted:
      return message_ids::drifted;
    case Verdict::suspect:
      return message_ids::drift_suspected;
    case Verdict::calibrated:
      return message_ids::cleared;
    case Verdict::not_evaluated:
      break;
  }
  return state.reason.starts_with("sensor_silent") ? message_ids::sensor_silent : message_ids::not_evaluated;
}

std::string number(std::uint64_t value) { return std::to_string(value); }

}  // namespace

/// Begins or goes on watching a pair: with the extrinsic that the last record put in force, unless the configuration
/// has a new one since.
Result<void> Service::take_over(const PairConfig& pair) {
  const CalibrationRecord* initial = ledger_.initial(pair.name);
  const bool configured_anew = initial == nullptr || !same(initial->T_camera_lidar, pair.T_camera_lidar);

  PairState state;
  state.since = now().wall;
  if (!configured_anew) {
    auto saved = ledger_.state(pair.name);
    if (saved && *saved)
      state = std::move(**saved);
    else if (!saved)
      journal(4, message_ids::store_failed,
              pair.name + ": " + saved.error().context + "; its evidence is gathered anew");
  }
  if (configured_anew) {
    CalibrationRecord record;
    record.decision = Decision::initial;
    record.asked_by = "configuration";
    record.reason = "taken from the configuration";
    record.T_camera_lidar = pair.T_camera_lidar;
    record.T_camera_lidar_before =
        initial != nullptr ? ledger_.in_force(pair.name)->T_camera_lidar : pair.T_camera_lidar;
    const auto written = ledger_.write(pair.name, state, {.record = std::move(record), .alert = {}}, now());
    if (!written) return tl::unexpected(written.error());
  }
  auto depth = std::make_unique<DepthSource>(pair, [this] {
    breathe(std::chrono::steady_clock::now());
    return !stopping();
  });
  watches_.push_back(
      std::make_unique<Watch>(Watch{.config = &pair,
                                    .topics = topics_of(pair),
                                    .depth = depth.get(),
                                    .monitor = PairMonitor(monitor_settings(pair), pair.camera.camera, std::move(depth),
                                                           ledger_.in_force(pair.name)->T_camera_lidar, state.drift),
                                    .state = state}));
  return {};
}

DriftAlert Service::alert(const Watch& watch, const PairState& after) const {
  DriftAlert alert;
  alert.stamp = now().wall;
  alert.vehicle = config_.vehicle;
  alert.pair = watch.config->name;
  alert.verdict = after.verdict;
  alert.previous_verdict = watch.state.verdict;
  alert.reason = after.reason;
  if (const auto estimate = watch.monitor.drift().misalignment())
    alert.misalignment = {estimate->delta, estimate->sigma};
  alert.record_sequence = ledger_.in_force(watch.config->name)->sequence;
  return alert;
}

/// Makes `after` the pair's state, durably, with the record and the alert that go with it; or changes nothing.
bool Service::write(Watch& watch, PairState after, std::optional<CalibrationRecord> record) {
  Ledger::Entry entry{.record = std::move(record), .alert = {}};
  const Verdict before = watch.state.verdict;
  if (after.verdict != before) {
    after.since = now().wall;
    entry.alert = alert(watch, after);
  }
  const std::string& name = watch.config->name;
  const auto written = ledger_.write(name, after, std::move(entry), now());
  if (!written) {
    if (failures_logged_.insert(written.error().code).second)
      journal(3, message_ids::store_failed,
              name + ": " + written.error().context + "; nothing was changed, the next pair tries again");
    return false;
  }
  failures_logged_.clear();
  watch.state = std::move(after);
  if (!written->alert) return true;
  if (auto sent = bus_.publish_alert(*written->alert); !sent)
    journal(4, message_ids::bus_failed,
            name + ": " + sent.error().context + "; the alert is kept and sent at the next start");
  const Verdict verdict = watch.state.verdict;
  const bool cleared = verdict == Verdict::calibrated || verdict == Verdict::not_evaluated;
  journal(cleared ? 5 : 4, message_id(watch.state),
          name + ": " + std::string(to_string(verdict)) + " (was " + std::string(to_string(before)) +
              "): " + watch.state.reason);
  return true;
}

json Service::recalibrate(Watch& watch, const std::string& asked_by, bool dry_run) {
  const auto outcome = watch.monitor.recalibrate();
  if (!outcome) return refusal(outcome.error().code == "not_ready" ? "not_ready" : "failed", outcome.error().context);
  const Recalibration& result = outcome->result;
  json reply{{"ok", true}, {"reason", result.reason}, {"record", nullptr}, {"result", in_json(result)}};
  if (dry_run) {
    reply["answer"] = "dry_run";
    reply["would"] = result.accepted ? "accepted" : "rejected";
    return reply;
  }
  CalibrationRecord record;
  const bool apply = watch.config->recalibration.mode == RecalibrationMode::apply;
  record.decision = !result.accepted ? Decision::rejected : apply ? Decision::accepted : Decision::proposed;
  record.asked_by = asked_by;
  record.reason = result.reason;
  record.T_camera_lidar = result.T_camera_lidar;
  record.T_camera_lidar_before = watch.monitor.T_camera_lidar();
  record.sigma = result.sigma;
  record.score = CalibrationRecord::Score{result.score_before, result.score_after, result.held_back_before,
                                          result.held_back_after};
  for (Timestamp stamp : outcome->frames) record.frame_stamps_ns.push_back(stamp.count());
  if (record.decision == Decision::accepted) {
    json put = put_in_force(watch, std::move(record));
    put["result"] = reply["result"];
    return put;
  }
  PairState after = watch.state;
  const std::uint64_t sequence = ledger_.next_sequence();
  const bool proposed = record.decision == Decision::proposed;
  if (proposed)
    after.proposed_record = sequence;
  else
    ++after.refusals;
  if (!write(watch, std::move(after), std::move(record)))
    return refusal("failed", "the record could not be written; see the journal");
  reply["answer"] = proposed ? "proposed" : "rejected";
  reply["record"] = sequence;
  journal(5, proposed ? message_ids::recalibration_proposed : message_ids::recalibration_rejected,
          watch.config->name + ": recalibration " + reply["answer"].get<std::string>() + " in record " +
              number(sequence) + ": " + result.reason);
  if (proposed) publish_extrinsics();
  // The same pairs would give the same answer: wait for new ones, twice as long each time.
  watch.monitor.forget_pairs();
  watch.retry_at =
      watch.state.evaluated + (std::uint64_t{watch.monitor.wanted_pairs()} << std::min(watch.state.refusals, 8));
  return reply;
}

/// Makes the record's extrinsic the one in force; what was learned belonged to the old one.
json Service::put_in_force(Watch& watch, CalibrationRecord record) {
  const Decision decision = record.decision;
  const std::string reason = record.reason;
  PairState after = watch.state;
  after.drift = {};
  after.verdict = Verdict::not_evaluated;
  after.reason = DriftMonitor(watch.monitor.drift().settings()).reason();
  after.score.reset();
  after.proposed_record.reset();
  after.refusals = 0;
  const std::uint64_t sequence = ledger_.next_sequence();
  if (!write(watch, std::move(after), std::move(record)))
    return refusal("failed", "the record could not be written; see the journal");
  watch.monitor.adopt(ledger_.in_force(watch.config->name)->T_camera_lidar);
  watch.retry_at = 0;
  const bool accepted = decision == Decision::accepted;
  journal(5, accepted ? message_ids::recalibration_accepted : message_ids::rolled_back,
          watch.config->name + ": " + (accepted ? "new extrinsic" : "earlier extrinsic") + " in force by record " +
              number(sequence) + ": " + reason);
  publish_extrinsics();
  return {{"ok", true}, {"answer", accepted ? "accepted" : "rolled_back"}, {"reason", reason}, {"record", sequence}};
}

json Service::accept(Watch& watch, const std::string& asked_by) {
  if (!watch.state.proposed_record) return refusal("not_found", "no proposal waits for an answer");
  const auto proposal = ledger_.find(watch.config->name, *watch.state.proposed_record);
  if (!proposal) return refusal("failed", proposal.error().context);
  CalibrationRecord record = *proposal;
  record.decision = Decision::accepted;
  record.asked_by = asked_by;
  record.reason = "proposal of record " + number(proposal->sequence) + " accepted";
  record.T_camera_lidar_before = watch.monitor.T_camera_lidar();
  return put_in_force(watch, std::move(record));
}

json Service::roll_back(Watch& watch, const json& to, const std::string& asked_by) {
  const CalibrationRecord* before = ledger_.before_in_force(watch.config->name);
  if (to.is_null() && before == nullptr) return refusal("not_found", "there is no earlier extrinsic to go back to");
  if (!to.is_null() && !to.is_number_unsigned()) return refusal("bad_request", "\"to\" is a record's number or null");
  const std::uint64_t target = to.is_null() ? before->sequence : to.get<std::uint64_t>();
  const auto earlier = ledger_.find(watch.config->name, target);
  if (!earlier)
    return refusal(earlier.error().code == "record_not_found" ? "not_found" : "failed", earlier.error().context);
  if (earlier->decision == Decision::rejected)
    return refusal("bad_request", "record " + number(target) + " was rejected; only what was in force can be again");
  CalibrationRecord record;
  record.decision = Decision::rolled_back;
  record.asked_by = asked_by;
  record.reason = "back to the extrinsic of record " + number(target);
  record.T_camera_lidar = earlier->T_camera_lidar;
  record.T_camera_lidar_before = watch.monitor.T_camera_lidar();
  record.sigma = earlier->sigma;
  return put_in_force(watch, std::move(record));
}

std::optional<json> Service::answer(const Question& question) {
  const auto& request = question.request;
  const std::string what = request["request"].get<std::string>();
  const std::string name =
      request.contains("pair") && request["pair"].is_string() ? request["pair"].get<std::string>() : "";
  const auto found = std::ranges::find_if(watches_, [&](const auto& watch) { return watch->config->name == name; });
  if (what == "doctor") {
    constexpr std::size_t most_waiting = 16;
    if (found == watches_.end() && !request.value("pair", json()).is_null())
      return refusal("not_found", "there is no pair '" + escape_control(name) + "'");
    if (doctor_questions_.size() >= most_waiting) return refusal("failed", "too many wait for the doctor; ask later");
    return std::nullopt;
  }
  if (what != "recalibrate" && what != "accept" && what != "rollback")
    return refusal("bad_request", "the requests are status, doctor, recalibrate, accept and rollback");
  if (!question.peer.may_change)
    return refusal("denied", "only root, the daemon's user and members of its group may ask for changes");
  if (found == watches_.end()) return refusal("not_found", "there is no pair '" + escape_control(name) + "'");
  const std::string asked_by = "uid:" + std::to_string(question.peer.uid);
  if (what == "accept") return accept(**found, asked_by);
  if (what == "rollback") return roll_back(**found, request.value("to", json()), asked_by);
  return recalibrate(**found, asked_by, request.value("dry_run", json(false)) == true);
}

}  // namespace calib
