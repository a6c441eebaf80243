#include "feed_event.hpp"

#include <algorithm>
#include <cmath>

#include "calib/geometry.hpp"

namespace calib {
namespace {

using nlohmann::json;

/// To a microradian and a micrometre, which keeps events short. Null: not known.
json three(const Eigen::Vector3d& vector) {
  json values = json::array();
  for (const double value : vector)
    values.push_back(std::isfinite(value) ? json(std::round(value * 1e6) / 1e6) : json());
  return values;
}

json estimate_json(const Vector6& delta, const Vector6& sigma) {
  return {{"rotation_rad", three(delta.head<3>())},
          {"translation_m", three(delta.tail<3>())},
          {"sigma_rotation_rad", three(sigma.head<3>())},
          {"sigma_translation_m", three(sigma.tail<3>())}};
}

/// The line of a minisign signature file that holds key and signature.
std::string signature_line(std::string_view signature_file) {
  const auto begin = signature_file.find('\n') + 1;
  return std::string(signature_file.substr(begin, signature_file.find('\n', begin) - begin));
}

json record_json(const SignedRecord& record, std::uint64_t sequence) {
  return {{"sequence", sequence},
          {"sha256", sha256_hex(record.canonical)},
          {"signature", signature_line(record.signature)}};
}

std::string record_type(Decision decision) {
  switch (decision) {
    case Decision::accepted:
      return "calibd.drift.recalibrated.v1";
    case Decision::initial:
    case Decision::baseline:
    case Decision::key_changed:
      return "calibd.record." + std::string(to_string(decision)) + ".v1";
    case Decision::proposed:
    case Decision::rejected:
    case Decision::rolled_back:
      break;
  }
  return "calibd.drift." + std::string(to_string(decision)) + ".v1";
}

/// Without the last `bytes` of it and what they leave of a character; the end says so.
std::string shortened(std::string text, std::size_t bytes) {
  constexpr std::string_view mark = " ...";
  if (text.ends_with(mark)) text.resize(text.size() - mark.size());
  std::size_t end = text.size() - std::min(text.size(), bytes);
  while (end > 0 && end < text.size() && (static_cast<unsigned char>(text[end]) & 0xC0) == 0x80) --end;
  return text.substr(0, end).append(mark);
}

json pair_state_json(const PairStatus& pair, bool with_estimate) {
  json state{{"name", pair.name}, {"verdict", to_string(pair.verdict)}, {"since", rfc3339(pair.since)}};
  if (pair.cause) state["cause"] = to_string(*pair.cause);
  if (pair.last_evaluated) state["last_evaluated"] = rfc3339(*pair.last_evaluated);
  if (pair.record) state["record"] = pair.record->sequence;
  if (pair.misalignment && with_estimate)
    state["estimate"] = estimate_json(pair.misalignment->delta, pair.misalignment->sigma);
  return state;
}

}  // namespace

std::string_view told_word(Verdict verdict) {
  switch (verdict) {
    case Verdict::suspect:
      return "suspected";
    case Verdict::drifted:
      return "confirmed";
    case Verdict::calibrated:
      return "cleared";
    case Verdict::not_evaluated:
      break;
  }
  return "unavailable";
}

FeedEvent verdict_event(const DriftAlert& alert, const std::optional<SignedRecord>& record,
                        std::uint64_t changes_held) {
  FeedEvent event{.type = "calibd.drift." + std::string(told_word(alert.verdict)) + ".v1",
                  .pair = alert.pair,
                  .time = alert.stamp,
                  .data = {{"verdict", to_string(alert.verdict)},
                           {"previous_verdict", to_string(alert.previous_verdict)},
                           {"reason", alert.reason}}};
  if (alert.misalignment.sigma.array().isFinite().any())
    event.data["estimate"] = estimate_json(alert.misalignment.delta, alert.misalignment.sigma);
  if (record) event.data["record"] = record_json(*record, alert.record_sequence);
  if (changes_held > 0) event.data["changes_held"] = changes_held;
  return event;
}

FeedEvent record_event(const CalibrationRecord& record, const SignedRecord& bytes) {
  FeedEvent event{.type = record_type(record.decision),
                  .pair = record.pair,
                  .time = record.wall_time,
                  .data = {{"decision", to_string(record.decision)},
                           {"reason", record.reason},
                           {"asked_by", record.asked_by},
                           {"record", record_json(bytes, record.sequence)}}};
  if (record.decision == Decision::key_changed) return event;
  event.data["T_camera_lidar"] = transform_json(record.T_camera_lidar);
  if (record.decision != Decision::initial && record.decision != Decision::baseline)
    event.data["estimate"] =
        estimate_json(perturbation_parameters(record.T_camera_lidar_before.inverse() * record.T_camera_lidar),
                      record.sigma.value_or(Vector6::Constant(std::numeric_limits<double>::infinity())));
  return event;
}

FeedEvent state_event(const Status& status, WallTime now) {
  FeedEvent event{.type = "calibd.feed.state.v1", .pair = "", .time = now, .data = {{"version", status.version}}};
  // What is around the pairs: attributes, names and signature.
  constexpr std::size_t most_bytes = Store::max_event_bytes - 800;
  for (const bool with_estimate : {true, false}) {
    json& pairs = event.data["pairs"] = json::array();
    for (const PairStatus& pair : status.pairs) pairs.push_back(pair_state_json(pair, with_estimate));
    if (canonical_json(pairs).size() <= most_bytes) return event;
  }
  json& pairs = event.data["pairs"];
  std::size_t left_out = 0;
  for (; canonical_json(pairs).size() > most_bytes; ++left_out) pairs.erase(pairs.size() - 1);
  event.data["pairs_left_out"] = left_out;
  return event;
}

std::string event_text(FeedEvent event, const FeedPlace& place, const SigningKey& key) {
  const std::string vehicle(place.vehicle);
  event.data["vehicle"] = vehicle;
  event.data["sequence"] = place.sequence;
  event.data["previous"] = place.previous;
  json all{{"specversion", "1.0"},
           {"id", vehicle + "-" + std::to_string(place.sequence)},
           {"source", "/calibd/" + vehicle},
           {"type", event.type},
           {"time", rfc3339(event.time)},
           {"expirytime", rfc3339(place.expires)},
           {"datacontenttype", "application/json"},
           {"data", std::move(event.data)}};
  if (!event.pair.empty()) all["subject"] = event.pair;
  // Base64 of two letters, the key's id and an Ed25519 signature.
  constexpr std::size_t most_bytes = Store::max_event_bytes - std::string_view(R"("signature":"",)").size() - 100;
  std::string text = canonical_json(all);
  while (text.size() > most_bytes) {
    json& reason = all["data"].at("reason");
    // A character of the reason takes six at most.
    reason = shortened(reason.get<std::string>(), (text.size() - most_bytes) / 6 + 1);
    text = canonical_json(all);
  }
  all["signature"] = signature_line(key.sign(text, ""));
  return canonical_json(all);
}

}  // namespace calib
