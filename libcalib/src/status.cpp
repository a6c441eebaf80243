#include "calib/status.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>

#include "calib/axis_words.hpp"
#include "calib/json_integer.hpp"
#include "calib/record.hpp"
#include "json_fields.hpp"

namespace calib {
namespace {

using nlohmann::json;

constexpr double cm_per_m = 100;

template <typename T>
json or_null(const std::optional<T>& value) {
  return value ? json(*value) : json();
}

double seconds(std::chrono::nanoseconds duration) { return std::chrono::duration<double>(duration).count(); }

json grounds_json(const Grounds& grounds) {
  return {{"pairs", grounds.pairs},
          {"boot_id", grounds.taken.boot_id},
          {"since_boot_s", seconds(grounds.taken.since_boot)},
          {"lifetime_s", seconds(grounds.lifetime)},
          {"evidence_sha256", grounds.evidence_sha256},
          {"not_written", or_null(grounds.not_written)}};
}

json input_json(const PairStatus::Input& input) { return {{"topic", input.topic}, {"age_s", or_null(input.age_s)}}; }

json misalignment_json(const PairStatus::Misalignment& misalignment) {
  const Vector6 &delta = misalignment.delta, &sigma = misalignment.sigma;
  const auto degrees = [](const Vector6& v) { return json_fields::array_of<3>(v.head<3>() / radians_per_degree); };
  const auto cm = [](const Vector6& v) { return json_fields::array_of<3>(v.tail<3>() * cm_per_m); };
  return {{"rotation_deg", degrees(delta)},
          {"translation_cm", cm(delta)},
          {"sigma_rotation_deg", degrees(sigma)},
          {"sigma_translation_cm", cm(sigma)}};
}

/// Null where infinite.
json detection_limit_json(const Vector6& shifts) {
  const auto three = [&](int first, double unit) {
    json array = json::array();
    for (int axis = first; axis < first + 3; ++axis)
      array.push_back(std::isfinite(shifts[axis]) ? json(shifts[axis] / unit) : json());
    return array;
  };
  return {{"rotation_deg", three(0, radians_per_degree)}, {"translation_cm", three(3, 1 / cm_per_m)}};
}

json axes_json(const PairStatus& pair) {
  json axes;
  for (int axis = 0; axis < 6; ++axis) axes[std::string(axis_names[axis])] = axis_in_words(pair, axis);
  return axes;
}

json record_json(const PairStatus::Record& record) {
  return {{"sequence", record.sequence},
          {"key_id", record.key_id},
          {"verified", record.verified},
          {"created", rfc3339(record.created)}};
}

json inputs_json(const PairStatus& pair) {
  json inputs{{"image", input_json(pair.image)},
              {"cloud", input_json(pair.cloud)},
              {"time_difference_ms", or_null(pair.time_difference_ms)}};
  if (pair.right_image) inputs["right_image"] = input_json(*pair.right_image);
  if (pair.depth) inputs["depth"] = input_json(*pair.depth);
  if (pair.motion) inputs["motion"] = input_json(*pair.motion);
  return inputs;
}

json remarks_json(const PairStatus& pair) {
  json remarks = json::object();
  for (const auto& [code, remark] : pair.remarks) remarks[code] = {{"count", remark.count}, {"text", remark.text}};
  return remarks;
}

json pair_json(const PairStatus& pair) {
  json object{{"name", pair.name},
              {"verdict", to_string(pair.verdict)},
              {"cause", pair.cause ? json(to_string(*pair.cause)) : json()},
              {"reason", pair.reason},
              {"evidence", pair.grounds ? grounds_json(*pair.grounds) : json()},
              {"since", rfc3339(pair.since)},
              {"last_evaluated", pair.last_evaluated ? json(rfc3339(*pair.last_evaluated)) : json()},
              {"evaluated", pair.evaluated},
              {"skipped", pair.skipped},
              {"remarks", remarks_json(pair)},
              {"score", nullptr},
              {"misalignment", nullptr},
              {"axes", nullptr},
              {"detection_limit", pair.detection_limit ? detection_limit_json(*pair.detection_limit) : json()},
              {"notice", nullptr},
              {"T_camera_lidar", transform_json(pair.T_camera_lidar)},
              {"proposed", nullptr},
              {"record", pair.record ? record_json(*pair.record) : json()},
              {"inputs", inputs_json(pair)}};
  if (pair.score)
    object["score"] = {{"current", pair.score->current},
                       {"best_neighbour", pair.score->best_neighbour},
                       {"baseline", or_null(pair.score->baseline)}};
  if (pair.misalignment) {
    object["misalignment"] = misalignment_json(*pair.misalignment);
    object["axes"] = axes_json(pair);
  }
  if (pair.notice)
    object["notice"] = {{"rotation_deg", pair.notice->rotation_rad / radians_per_degree},
                        {"driving_s", pair.notice->driving_s}};
  if (pair.proposed)
    object["proposed"] = {{"T_camera_lidar", transform_json(pair.proposed->T_camera_lidar)},
                          {"record_sequence", pair.proposed->record_sequence}};
  return object;
}

// Reading: whatever these throw becomes `malformed_status`.

template <typename T>
std::optional<T> optional_from(const json& value) {
  return value.is_null() ? std::nullopt : std::optional(value.get<T>());
}

WallTime time_from(const json& value) {
  const auto time = parse_rfc3339(value.get_ref<const std::string&>());
  if (!time) throw std::invalid_argument(time.error().context);
  return *time;
}

Verdict verdict_from(const json& value) {
  const auto verdict = parse_verdict(value.get_ref<const std::string&>());
  if (!verdict) throw std::invalid_argument(verdict.error().context);
  return *verdict;
}

std::chrono::nanoseconds duration_from(const json& value) {
  const double seconds = value.get<double>();
  if (!(std::abs(seconds) < 1e9)) throw std::invalid_argument("a duration is out of range");
  return std::chrono::round<std::chrono::nanoseconds>(std::chrono::duration<double>(seconds));
}

Grounds grounds_from(const json& object) {
  return {integer_from<std::uint64_t>(object.at("pairs")),
          {object.at("boot_id").get<std::string>(), duration_from(object.at("since_boot_s"))},
          duration_from(object.at("lifetime_s")),
          object.at("evidence_sha256").get<std::string>(),
          optional_from<std::string>(object.at("not_written"))};
}

PairStatus::Misalignment misalignment_from(const json& object) {
  const auto six = [&](const char* rotation_deg, const char* translation_cm) {
    Vector6 values;
    values.head<3>() = json_fields::vector_from<3>(object.at(rotation_deg)) * radians_per_degree;
    values.tail<3>() = json_fields::vector_from<3>(object.at(translation_cm)) / cm_per_m;
    return values;
  };
  return {six("rotation_deg", "translation_cm"), six("sigma_rotation_deg", "sigma_translation_cm")};
}

Vector6 detection_limit_from(const json& object) {
  Vector6 shifts;
  const auto three = [&](const json& array, int first, double unit) {
    if (!array.is_array() || array.size() != 3) throw std::invalid_argument("a list of 3 is needed");
    for (int i = 0; i < 3; ++i)
      shifts[first + i] = array[i].is_null() ? std::numeric_limits<double>::infinity() : array[i].get<double>() * unit;
  };
  three(object.at("rotation_deg"), 0, radians_per_degree);
  three(object.at("translation_cm"), 3, 1 / cm_per_m);
  return shifts;
}

PairStatus::Input input_from(const json& object) {
  return {object.at("topic").get<std::string>(), optional_from<double>(object.at("age_s"))};
}

PairStatus pair_from(const json& object) {
  PairStatus pair;
  pair.name = object.at("name").get<std::string>();
  pair.verdict = verdict_from(object.at("verdict"));
  // A word that only a newer calibd knows is none; the reason says it.
  if (const json& cause = object.at("cause"); !cause.is_null())
    pair.cause = parse_error_code(cause.get_ref<const std::string&>());
  pair.reason = object.at("reason").get<std::string>();
  // A snapshot of an earlier calibd lacks it: its verdict rests on nothing that could be checked.
  if (const auto grounds = object.find("evidence"); grounds != object.end() && !grounds->is_null())
    pair.grounds = grounds_from(*grounds);
  pair.since = time_from(object.at("since"));
  if (const json& last = object.at("last_evaluated"); !last.is_null()) pair.last_evaluated = time_from(last);
  pair.evaluated = integer_from<std::uint64_t>(object.at("evaluated"));
  for (const auto& [reason, count] : object.at("skipped").get_ref<const json::object_t&>())
    pair.skipped[reason] = integer_from<std::uint64_t>(count);
  if (const auto remarks = object.find("remarks"); remarks != object.end())  // came later
    for (const auto& [code, remark] : remarks->get_ref<const json::object_t&>())
      pair.remarks[code] = {integer_from<std::uint64_t>(remark.at("count")), remark.at("text").get<std::string>()};
  if (const json& score = object.at("score"); !score.is_null())
    pair.score = {score.at("current").get<double>(), score.at("best_neighbour").get<double>(),
                  optional_from<double>(score.at("baseline"))};
  if (const json& misalignment = object.at("misalignment"); !misalignment.is_null())
    pair.misalignment = misalignment_from(misalignment);
  // Came later: a snapshot of an earlier calibd lacks it.
  if (const auto shifts = object.find("detection_limit"); shifts != object.end() && !shifts->is_null())
    pair.detection_limit = detection_limit_from(*shifts);
  if (const auto notice = object.find("notice"); notice != object.end() && !notice->is_null())
    pair.notice = {notice->at("rotation_deg").get<double>() * radians_per_degree,
                   notice->at("driving_s").get<double>()};
  pair.T_camera_lidar = json_fields::transform_from(object.at("T_camera_lidar"));
  if (const json& proposed = object.at("proposed"); !proposed.is_null())
    pair.proposed = {json_fields::transform_from(proposed.at("T_camera_lidar")),
                     integer_from<std::uint64_t>(proposed.at("record_sequence"))};
  if (const json& record = object.at("record"); !record.is_null())
    pair.record = {integer_from<std::uint64_t>(record.at("sequence")), record.at("key_id").get<std::string>(),
                   record.at("verified").get<bool>(), time_from(record.at("created"))};
  const json& inputs = object.at("inputs");
  pair.image = input_from(inputs.at("image"));
  pair.cloud = input_from(inputs.at("cloud"));
  if (inputs.contains("right_image")) pair.right_image = input_from(inputs.at("right_image"));
  if (inputs.contains("depth")) pair.depth = input_from(inputs.at("depth"));
  if (inputs.contains("motion")) pair.motion = input_from(inputs.at("motion"));
  pair.time_difference_ms = optional_from<double>(inputs.at("time_difference_ms"));
  return pair;
}

}  // namespace

std::string axis_in_words(const PairStatus& pair, int axis) {
  if (pair.detection_limit && !std::isfinite((*pair.detection_limit)[axis])) return "not observable";
  return pair.misalignment ? motion_in_words(axis, pair.misalignment->delta[axis], pair.misalignment->sigma[axis])
                           : "not known yet";
}

json to_json(const Status& status) {
  json pairs = json::array();
  for (const PairStatus& pair : status.pairs) pairs.push_back(pair_json(pair));
  return {
      {"schema", 1},
      {"vehicle", status.vehicle},
      {"daemon", {{"running", status.running}, {"version", status.version}, {"uptime_s", status.uptime_s}}},
      {"pairs", pairs},
      {"records", {{"missing", or_null(status.records_missing)}, {"signing_refused", or_null(status.signing_refused)}}},
      {"feed", {{"queued", status.feed_queued}}}};
}

void expire(Status& status, const BootTime& now) {
  for (PairStatus& pair : status.pairs) {
    Claim now_said = claim({pair.verdict, pair.cause, std::move(pair.reason)}, pair.grounds, now);
    pair.verdict = now_said.verdict;
    pair.cause = now_said.cause;
    pair.reason = std::move(now_said.reason);
  }
}

Result<Status> parse_status(const json& object) {
  try {
    if (object.at("schema") != 1) return fail(ErrorCode::malformed_status, "the status has a schema other than 1");
    Status status;
    status.vehicle = object.at("vehicle").get<std::string>();
    const json& daemon = object.at("daemon");
    status.running = daemon.at("running").get<bool>();
    status.version = daemon.at("version").get<std::string>();
    status.uptime_s = daemon.at("uptime_s").get<double>();
    for (const json& pair : object.at("pairs").get_ref<const json::array_t&>()) status.pairs.push_back(pair_from(pair));
    status.feed_queued = integer_from<std::uint64_t>(object.at("feed").at("queued"));
    if (const auto records = object.find("records"); records != object.end()) {
      status.records_missing = optional_from<std::string>(records->at("missing"));
      status.signing_refused = optional_from<std::string>(records->value("signing_refused", json()));  // came later
    }
    return status;
  } catch (const std::exception& error) {
    return fail(ErrorCode::malformed_status, std::string("this is not a status of calibd: ") + error.what());
  }
}

}  // namespace calib
