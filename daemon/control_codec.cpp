#include "control_codec.hpp"

#include <nlohmann/json.hpp>

#include "control.hpp"

namespace calib {
namespace {

using nlohmann::json;

json vector3(const Eigen::Vector3d& v) { return {v.x(), v.y(), v.z()}; }

json encode(const Error& error) { return refusal(to_string(error.code), error.context); }

json encode(const Status& status) { return {{"ok", true}, {"status", to_json(status)}}; }

json encode(const RecordsPage& page) {
  json records = json::array();
  for (const SignedRecord& record : page.records)
    records.push_back({{"canonical", record.canonical}, {"signature", record.signature}});
  return {{"ok", true}, {"stored", page.stored}, {"records", std::move(records)}};
}

json encode(const PairFinding& check) {
  const Finding& finding = check.finding;
  json encoded{{"pair", check.pair},
               {"check", finding.check},
               {"result", to_string(finding.result)},
               {"seen", escape_control(finding.seen)}};
  if (finding.code.empty()) return encoded;
  encoded["code"] = finding.code;
  encoded["cause"] = escape_control(finding.cause);
  encoded["remedy"] = escape_control(finding.remedy);
  return encoded;
}

json encode(const DiagnosisReport& report) {
  json checks = json::array(), overlays = json::array();
  for (const PairFinding& check : report.checks) checks.push_back(encode(check));
  for (const Overlay& overlay : report.overlays)
    overlays.push_back({{"pair", overlay.pair}, {"file", overlay.file.string()}});
  return {{"ok", true}, {"checks", std::move(checks)}, {"overlays", std::move(overlays)}};
}

json encode(const Recalibration& result) {
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

json encode(const Answer& answer) {
  json reply{{"ok", true},
             {"answer", answer.dry_run ? "dry_run" : to_string(answer.decision)},
             {"reason", answer.reason},
             {"record", answer.record ? json(*answer.record) : json()}};
  // With `dry_run` calibd says what its gates would, whatever the mode makes of that.
  if (answer.dry_run) reply["would"] = answer.decision == Decision::rejected ? "rejected" : "accepted";
  if (answer.result) reply["result"] = encode(*answer.result);
  return reply;
}

json encode(const ConfigChanges& changes) {
  return {
      {"ok", true}, {"answer", "reloaded"}, {"taken_over", changes.taken_over}, {"need_restart", changes.need_restart}};
}

json encode(const FeedPage& page) {
  json events = json::array();
  for (const Store::Event& event : page.events)
    events.push_back({{"sequence", event.sequence},
                      {"priority", event.priority == Store::Priority::state ? "state" : "alert"},
                      {"event", event.json}});
  return {{"ok", true},
          {"vehicle", page.vehicle},
          {"run", page.run},
          {"waiting", page.waiting},
          {"events", std::move(events)}};
}

json encode(const Acknowledged& acknowledged) { return {{"ok", true}, {"waiting", acknowledged.waiting}}; }

Result<ControlRequest> decode_feed(const json& request) {
  const json after = request.value("after", json(0U)), limit = request.value("limit", json(FeedRequest::most_events));
  if (!after.is_number_unsigned()) return fail(ErrorCode::bad_request, "\"after\" is an event's number, or 0");
  if (!limit.is_number_unsigned() || limit == 0U || limit > FeedRequest::most_events)
    return fail(ErrorCode::bad_request, "\"limit\" is 1 to " + std::to_string(FeedRequest::most_events));
  return FeedRequest{after.get<std::uint64_t>(), limit.get<std::size_t>(), request.value("wait", json(false)) == true};
}

std::string pair_of(const json& request) {
  const json pair = request.value("pair", json());
  return pair.is_string() ? pair.get<std::string>() : "";
}

/// A number, or null or nothing.
Result<std::optional<std::uint64_t>> number_of(const json& request, const char* name, const char* what) {
  const json value = request.value(name, json());
  if (value.is_null()) return std::optional<std::uint64_t>{};
  if (!value.is_number_unsigned())
    return fail(ErrorCode::bad_request, '"' + std::string(name) + "\" is " + what + " or null");
  return std::optional(value.get<std::uint64_t>());
}

Result<Said> said_in(const json& request) {
  Said said;
  auto login = number_of(request, "login", "a user's number");
  if (!login) return propagate(login);
  said.login = *login;
  const json comment = request.value("comment", json());
  if (comment.is_null()) return said;
  if (!comment.is_string()) return fail(ErrorCode::bad_request, "\"comment\" is a text or null");
  said.comment = comment.get<std::string>();
  return check_comment(said.comment).map([&] { return std::move(said); });
}

}  // namespace

Result<ControlRequest> decode_request(const json& request) {
  const std::string& what = request.at("request").get_ref<const std::string&>();
  if (what == "status") return StatusRequest{};
  if (what == "records") {
    const json from = request.value("from", json());
    if (!from.is_number_unsigned() || from == 0U) return fail(ErrorCode::bad_request, "\"from\" is a record's number");
    return RecordsRequest{from.get<std::uint64_t>()};
  }
  if (what == "doctor") {
    if (request.value("pair", json()).is_null()) return DiagnosisRequest{};
    return DiagnosisRequest{pair_of(request)};
  }
  auto said = said_in(request);
  if (!said) return propagate(said);
  if (what == "recalibrate")
    return RecalibrationRequest{pair_of(request), request.value("dry_run", json(false)) == true, std::move(*said)};
  if (what == "reload") return ReloadRequest{};
  if (what == "accept") return AcceptRequest{pair_of(request), std::move(*said)};
  if (what == "rollback") {
    const auto to = number_of(request, "to", "a record's number");
    if (!to) return propagate(to);
    return RollbackRequest{pair_of(request), *to, std::move(*said)};
  }
  if (what == "rotate_key") {
    const auto doubted_from = number_of(request, "doubted_from", "a record's number");
    if (!doubted_from) return propagate(doubted_from);
    return KeyRequest{request.value("lost", json(false)) == true, *doubted_from, std::move(*said)};
  }
  if (what == "feed") return decode_feed(request);
  if (what == "acknowledge") {
    const json through = request.value("through", json()), run = request.value("run", json());
    if (!through.is_number_unsigned() || !run.is_string())
      return fail(ErrorCode::bad_request, "\"through\" is an event's number, and \"run\" of the reply that had it");
    return AcknowledgeRequest{through.get<std::uint64_t>(), run.get<std::string>()};
  }
  return fail(ErrorCode::bad_request,
              "the requests are status, records, doctor, recalibrate, accept, rollback, reload, rotate_key, feed and "
              "acknowledge");
}

bool only_shows(const ControlRequest& request) {
  return std::holds_alternative<StatusRequest>(request) || std::holds_alternative<RecordsRequest>(request) ||
         std::holds_alternative<FeedRequest>(request);
}

json encode_reply(const ControlReply& reply) {
  return std::visit([](const auto& each) { return encode(each); }, reply);
}

}  // namespace calib
