#include "calib/record.hpp"

#include <algorithm>
#include <array>
#include <charconv>
#include <nlohmann/json.hpp>

#include "json_fields.hpp"

namespace calib {
namespace {

using nlohmann::json;

constexpr std::array<Decision, 7> decisions{Decision::initial,    Decision::accepted,    Decision::proposed,
                                            Decision::rejected,   Decision::rolled_back, Decision::baseline,
                                            Decision::key_changed};
/// More than any record needs; a reader stops here before it parses.
constexpr std::size_t largest_record = 1 << 20;

void require(bool holds, const char* what) {
  if (!holds) throw std::invalid_argument(what);
}

json score_json(const CalibrationRecord::Score& score) {
  return {{"before", score.before},
          {"after", score.after},
          {"held_back_before", score.held_back_before},
          {"held_back_after", score.held_back_after}};
}

json matrix_json(const Matrix6& matrix) {
  json rows = json::array();
  for (int row = 0; row < 6; ++row) rows.push_back(json_fields::array_of<6>(matrix.row(row).transpose()));
  return rows;
}

json baseline_json(const CalibrationRecord::Baseline& baseline) {
  return {{"pairs", baseline.pairs},
          {"slope", json_fields::array_of<6>(baseline.slope)},
          {"slope_covariance", matrix_json(baseline.slope_covariance)},
          {"slope_correlation", json_fields::array_of<6>(baseline.slope_correlation)},
          {"response", matrix_json(baseline.sensitivity)},
          {"response_deviation", json_fields::array_of<6>(baseline.sensitivity_deviation)},
          {"peak", baseline.prominence},
          {"peak_deviation", baseline.prominence_deviation},
          {"peak_correlation", baseline.prominence_correlation},
          {"score", baseline.score},
          {"score_deviation", baseline.score_deviation}};
}

json or_null(const std::string& text) { return text.empty() ? json() : json(text); }

json key_change_json(const KeyChange& change) {
  return {{"previous", change.previous.text()},
          {"next", change.next.text()},
          {"previous_lost", change.previous_lost},
          {"doubted_from", change.doubted_from ? json(*change.doubted_from) : json()}};
}

std::uint64_t schema_of(const CalibrationRecord& record) {
  if (record.key_change || !record.comment.text.empty()) return 3;
  return record.evidence_sha256.empty() ? 1 : 2;
}

/// What is about a pair and its extrinsic.
void add_pair(const CalibrationRecord& record, json& object) {
  json stamps = json::array();
  for (const std::int64_t stamp : record.frame_stamps_ns) stamps.push_back(std::to_string(stamp));
  json sigma;
  if (record.sigma)
    sigma = {{"rotation_rad", json_fields::array_of<3>(record.sigma->head<3>())},
             {"translation_m", json_fields::array_of<3>(record.sigma->tail<3>())}};
  object["pair"] = record.pair;
  object["T_camera_lidar"] = transform_json(record.T_camera_lidar);
  object["T_camera_lidar_before"] = transform_json(record.T_camera_lidar_before);
  object["sigma"] = std::move(sigma);
  object["score"] = record.score ? score_json(*record.score) : json();
  object["frame_stamps_ns"] = std::move(stamps);
  if (schema_of(record) >= 2) object["evidence_sha256"] = record.evidence_sha256;
  if (record.baseline) object["baseline"] = baseline_json(*record.baseline);
}

json record_json(const CalibrationRecord& record) {
  json object{{"schema", schema_of(record)},
              {"vehicle", record.vehicle},
              {"sequence", record.sequence},
              {"previous_sha256", record.previous_sha256},
              {"decision", to_string(record.decision)},
              {"reason", record.reason},
              {"asked_by", record.asked_by},
              {"configuration_sha256", record.configuration_sha256},
              {"software_version", record.software_version},
              {"software_sha256", record.software_sha256},
              {"wall_time", rfc3339_ns(record.wall_time)},
              {"boot_id", record.boot_id},
              {"boot_time_ns", std::to_string(record.boot_time.count())}};
  if (schema_of(record) >= 3) {
    object["comment"] = or_null(record.comment.text);
    object["login"] = or_null(record.comment.login);
  }
  if (record.key_change)
    object["key_change"] = key_change_json(*record.key_change);
  else
    add_pair(record, object);
  return object;
}

// The readers below ask for the exact JSON type (get_ref does not convert), so that one record has one form.

const std::string& text_at(const json& object, const char* key) { return object.at(key).get_ref<const std::string&>(); }

double number_at(const json& object, const char* key) { return object.at(key).get_ref<const double&>(); }

std::string sha256_at(const json& object, const char* key) {
  const std::string& text = text_at(object, key);
  require(text.size() == 64 && text.find_first_not_of("0123456789abcdef") == std::string::npos,
          "a SHA-256 is not 64 lower-case hexadecimal digits");
  return text;
}

std::int64_t nanoseconds_from(const std::string& text) {
  std::int64_t value = 0;
  std::from_chars(text.data(), text.data() + text.size(), value);
  require(std::to_string(value) == text, "a time in nanoseconds is not a whole number");
  return value;
}

/// A whole number would be a second way to write the same value (`0` for `0.0`).
void require_floats(const json& list) {
  for (const json& number : list) require(number.is_number_float(), "a list holds what is not a number with a point");
}

Vector6 strict_vector_from(const json& list) {
  require_floats(list);
  return json_fields::vector_from<6>(list);
}

Matrix6 strict_matrix_from(const json& rows) {
  require(rows.is_array() && rows.size() == 6, "a matrix has not six rows");
  Matrix6 matrix;
  for (int row = 0; row < 6; ++row) matrix.row(row) = strict_vector_from(rows[row]).transpose();
  return matrix;
}

CalibrationRecord::Baseline baseline_from(const json& object) {
  require(object.size() == 11, "the baseline has a field that it should not have");
  CalibrationRecord::Baseline baseline;
  baseline.pairs = object.at("pairs").get_ref<const std::uint64_t&>();
  baseline.slope = strict_vector_from(object.at("slope"));
  baseline.slope_covariance = strict_matrix_from(object.at("slope_covariance"));
  baseline.slope_correlation = strict_vector_from(object.at("slope_correlation"));
  baseline.sensitivity = strict_matrix_from(object.at("response"));
  baseline.sensitivity_deviation = strict_vector_from(object.at("response_deviation"));
  baseline.prominence = number_at(object, "peak");
  baseline.prominence_deviation = number_at(object, "peak_deviation");
  baseline.prominence_correlation = number_at(object, "peak_correlation");
  baseline.score = number_at(object, "score");
  baseline.score_deviation = number_at(object, "score_deviation");
  require(baseline.pairs >= 2 && baseline.pairs <= 1'000'000, "a baseline is of two pairs or more");
  require((baseline.slope_covariance.diagonal().array() >= 0).all() && baseline.score_deviation >= 0 &&
              baseline.prominence_deviation >= 0 && (baseline.sensitivity_deviation.array() >= 0).all(),
          "a deviation of the baseline is negative");
  require(baseline.slope_covariance == baseline.slope_covariance.transpose(), "the covariance is not symmetric");
  return baseline;
}

Vector6 sigma_from(const json& object) {
  require(object.size() == 2, "sigma has a field that it should not have");
  for (const json& list : object) require_floats(list);
  Vector6 sigma;
  sigma.head<3>() = json_fields::vector_from<3>(object.at("rotation_rad"));
  sigma.tail<3>() = json_fields::vector_from<3>(object.at("translation_m"));
  return sigma;
}

CalibrationRecord::Score score_from(const json& object) {
  require(object.size() == 4, "score has a field that it should not have");
  return {number_at(object, "before"), number_at(object, "after"), number_at(object, "held_back_before"),
          number_at(object, "held_back_after")};
}

RigidTransform strict_transform_from(const json& object) {
  require(object.size() == 2, "a transform has a field that it should not have");
  for (const json& list : object) require_floats(list);
  return json_fields::transform_from(object);
}

Decision decision_from(const std::string& text) {
  const auto found = std::ranges::find_if(decisions, [&](Decision decision) { return to_string(decision) == text; });
  require(found != decisions.end(), "the decision is not one of those there are");
  return *found;
}

WallTime wall_time_from(const std::string& text) {
  const auto time = parse_rfc3339(text);
  require(time && rfc3339_ns(*time) == text, "wall_time is not a time with nine decimals");
  return *time;
}

PublicKey public_key_from(const json& value) {
  const auto key = parse_public_key(value.get_ref<const std::string&>());
  require(key.has_value(), "a public key is not one of minisign's");
  return *key;
}

KeyChange key_change_from(const json& object) {
  require(object.size() == 4, "the change of keys has a field that it should not have");
  KeyChange change{public_key_from(object.at("previous")), public_key_from(object.at("next")),
                   object.at("previous_lost").get_ref<const bool&>(), std::nullopt};
  if (const json& from = object.at("doubted_from"); !from.is_null())
    change.doubted_from = from.get_ref<const std::uint64_t&>();
  require(change.previous != change.next, "the change of keys is from a key to itself");
  return change;
}

/// What every record of every schema has, in 13 fields.
CalibrationRecord common_fields_from(const json& object) {
  CalibrationRecord record;
  record.vehicle = text_at(object, "vehicle");
  record.sequence = object.at("sequence").get_ref<const std::uint64_t&>();
  record.previous_sha256 = sha256_at(object, "previous_sha256");
  record.decision = decision_from(text_at(object, "decision"));
  record.reason = text_at(object, "reason");
  record.asked_by = text_at(object, "asked_by");
  record.configuration_sha256 = sha256_at(object, "configuration_sha256");
  record.software_version = text_at(object, "software_version");
  record.software_sha256 = sha256_at(object, "software_sha256");
  record.wall_time = wall_time_from(text_at(object, "wall_time"));
  record.boot_id = text_at(object, "boot_id");
  record.boot_time = std::chrono::nanoseconds(nanoseconds_from(text_at(object, "boot_time_ns")));
  require(record.sequence > 0, "sequence counts from 1");
  return record;
}

/// What a record about a pair has beside that, in 6 fields; one of decision `baseline` has one more.
void read_pair(const json& object, CalibrationRecord& record) {
  require(record.decision != Decision::key_changed, "a change of keys is not about a pair");
  record.pair = text_at(object, "pair");
  record.T_camera_lidar = strict_transform_from(object.at("T_camera_lidar"));
  record.T_camera_lidar_before = strict_transform_from(object.at("T_camera_lidar_before"));
  if (const json& sigma = object.at("sigma"); !sigma.is_null()) record.sigma = sigma_from(sigma);
  if (const json& score = object.at("score"); !score.is_null()) record.score = score_from(score);
  if (record.decision == Decision::baseline) record.baseline = baseline_from(object.at("baseline"));
  for (const json& stamp : object.at("frame_stamps_ns").get_ref<const json::array_t&>())
    record.frame_stamps_ns.push_back(nanoseconds_from(stamp.get_ref<const std::string&>()));
}

void require_fields(const json& object, const CalibrationRecord& record, std::size_t fields) {
  require(object.size() == fields + record.baseline.has_value(), "the record has a field that it should not have");
}

CalibrationRecord schema_1_from(const json& object) {
  CalibrationRecord record = common_fields_from(object);
  read_pair(object, record);
  require_fields(object, record, 19);
  return record;
}

CalibrationRecord schema_2_from(const json& object) {
  CalibrationRecord record = common_fields_from(object);
  read_pair(object, record);
  record.evidence_sha256 = sha256_at(object, "evidence_sha256");
  require_fields(object, record, 20);
  return record;
}

/// With a comment, or a change of keys, which may have one.
CalibrationRecord schema_3_from(const json& object) {
  CalibrationRecord record = common_fields_from(object);
  if (const json& login = object.at("login"); !login.is_null())
    record.comment.login = login.get_ref<const std::string&>();
  if (const json& comment = object.at("comment"); !comment.is_null()) {
    record.comment.text = comment.get_ref<const std::string&>();
    require(check_comment(record.comment.text).has_value(), "the comment is empty, too long or has control characters");
  }
  require(object.at("login").is_null() || !record.comment.login.empty(), "login is empty");
  if (record.decision == Decision::key_changed) {
    record.key_change = key_change_from(object.at("key_change"));
    require_fields(object, record, 16);
    return record;
  }
  require(!record.comment.text.empty(), "without a comment it is of schema 2");
  read_pair(object, record);
  record.evidence_sha256 = sha256_at(object, "evidence_sha256");
  require_fields(object, record, 22);
  return record;
}

/// The reader of each schema. A new schema adds a line; the readers before it stay as they are, for records that are
/// signed already.
constexpr struct {
  std::uint64_t schema;
  CalibrationRecord (*read)(const json& object);
} readers[] = {{1, schema_1_from}, {2, schema_2_from}, {3, schema_3_from}};

CalibrationRecord record_from(const json& object) {
  const std::uint64_t schema = object.at("schema").get_ref<const std::uint64_t&>();
  for (const auto& reader : readers)
    if (reader.schema == schema) return reader.read(object);
  throw std::invalid_argument("it is of schema " + std::to_string(schema) + ", and this program knows 1 to " +
                              std::to_string(std::rbegin(readers)->schema));
}

}  // namespace

std::string_view to_string(Decision decision) {
  switch (decision) {
    case Decision::initial:
      return "initial";
    case Decision::accepted:
      return "accepted";
    case Decision::proposed:
      return "proposed";
    case Decision::rejected:
      return "rejected";
    case Decision::rolled_back:
      return "rolled_back";
    case Decision::baseline:
      return "baseline";
    case Decision::key_changed:
      return "key_changed";
  }
  return "";
}

bool puts_in_force(Decision decision) {
  return decision == Decision::initial || decision == Decision::accepted || decision == Decision::rolled_back;
}

nlohmann::json transform_json(const RigidTransform& transform) {
  return {{"translation_m", translation_m(transform)}, {"quaternion_xyzw", quaternion_xyzw(transform)}};
}

std::string record_file_name(std::uint64_t sequence) {
  std::string digits = std::to_string(sequence);
  if (digits.size() < 6) digits.insert(0, 6 - digits.size(), '0');
  return digits + ".json";
}

std::string canonical_json(const json& json) { return json_fields::canonical_text(json); }

Result<void> check_comment(std::string_view comment) {
  if (comment.empty() || comment.size() > longest_comment)
    return fail(ErrorCode::bad_request, "a comment has 1 to " + std::to_string(longest_comment) + " bytes");
  if (escape_control(comment) != comment)
    return fail(ErrorCode::bad_request, "a comment is one line of UTF-8 without control characters");
  return {};
}

std::string canonical_bytes(const CalibrationRecord& record) {
  return json_fields::canonical_text(record_json(record));
}

Result<CalibrationRecord> parse_record(std::string_view canonical) {
  try {
    require(canonical.size() <= largest_record, "it is larger than a record can be");
    const json object = json::parse(canonical);
    CalibrationRecord record = record_from(object);
    // After the shape: `record_from` has bounded how deep the text nests.
    require(json_fields::canonical_text(object) == canonical, "its bytes are not in canonical form");
    return record;
  } catch (const std::exception& error) {
    return fail(ErrorCode::malformed_record, std::string("this is not a calibration record: ") + error.what());
  }
}

}  // namespace calib
