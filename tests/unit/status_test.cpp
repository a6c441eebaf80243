#include "calib/status.hpp"

#include <limits>
#include <nlohmann/json.hpp>

#include "support/catch.hpp"
#include "support/records.hpp"

using namespace calib;
using namespace calib::test;
using nlohmann::json;

namespace {

/// JSON keeps milliseconds.
WallTime random_time(std::mt19937& random) { return std::chrono::milliseconds(random() * std::int64_t{400}); }

PairStatus random_pair(std::mt19937& random) {
  const auto maybe = [&] { return random() % 2 == 0; };
  std::uniform_real_distribution<double> unit(-1, 1);
  const auto vector6 = [&] {
    Vector6 values;
    for (double& value : values) value = unit(random);
    return values;
  };
  PairStatus pair;
  pair.name = random_text(random);
  pair.verdict = static_cast<Verdict>(random() % 4);
  if (pair.verdict == Verdict::not_evaluated) pair.cause = all_error_codes[random() % all_error_codes.size()];
  pair.reason = random_text(random);
  if (maybe())
    pair.grounds = Grounds{.pairs = random(),
                           .taken = {random_text(random), std::chrono::milliseconds(random())},
                           .lifetime = std::chrono::milliseconds(random() % 100'000),
                           .evidence_sha256 = random_text(random),
                           .not_written = maybe() ? std::optional(random_text(random)) : std::nullopt};
  pair.since = random_time(random);
  if (maybe()) pair.last_evaluated = random_time(random);
  pair.evaluated = random();
  for (int i = static_cast<int>(random() % 4); i > 0; --i) pair.skipped[random_text(random)] = random();
  if (maybe()) pair.score = {unit(random), unit(random), maybe() ? std::optional(unit(random)) : std::nullopt};
  if (maybe()) pair.misalignment = PairStatus::Misalignment{vector6(), vector6()};
  if (maybe()) {
    pair.detection_limit = vector6().cwiseAbs();
    for (double& shift : *pair.detection_limit)
      if (maybe()) shift = std::numeric_limits<double>::infinity();
  }
  if (maybe()) pair.notice = {std::abs(unit(random)), std::abs(unit(random))};
  pair.T_camera_lidar = random_transform(random);
  if (maybe()) pair.proposed = PairStatus::Proposed{random_transform(random), random()};
  if (maybe()) pair.record = PairStatus::Record{random(), random_text(random), maybe(), random_time(random)};
  const auto input = [&] {
    return PairStatus::Input{random_text(random), maybe() ? std::optional(unit(random)) : std::nullopt};
  };
  pair.image = input();
  pair.cloud = input();
  if (maybe()) pair.right_image = input();
  if (maybe()) pair.depth = input();
  if (maybe()) pair.motion = input();
  if (maybe()) pair.time_difference_ms = unit(random);
  return pair;
}

Status random_status(std::mt19937& random) {
  Status status{random_text(random), random() % 2 == 0, "1.2.3", 0.5 * static_cast<double>(random()), {}, random()};
  for (int i = static_cast<int>(random() % 4); i > 0; --i) status.pairs.push_back(random_pair(random));
  return status;
}

}  // namespace

TEST_CASE("any status comes back from its JSON") {
  std::mt19937 random(1);
  for (int i = 0; i < 2'000; ++i) {
    const Status status = random_status(random);
    // As text and back: that is the way it goes.
    const json sent = json::parse(to_json(status).dump());
    const Status read = require_ok(parse_status(sent));
    REQUIRE(read.pairs.size() == status.pairs.size());
    CHECK(read.running == status.running);
    CHECK(read.feed_queued == status.feed_queued);
    for (std::size_t p = 0; p < status.pairs.size(); ++p) {
      CHECK(read.pairs[p].verdict == status.pairs[p].verdict);
      CHECK(read.pairs[p].cause == status.pairs[p].cause);
      CHECK(read.pairs[p].since == status.pairs[p].since);
      CHECK(read.pairs[p].skipped == status.pairs[p].skipped);
      CHECK(read.pairs[p].T_camera_lidar.isApprox(status.pairs[p].T_camera_lidar, 1e-14));
    }
    // Numbers that went through degrees or a matrix may differ in their last bits, nothing else may.
    const json again = to_json(read).flatten();
    const json before = sent.flatten();
    REQUIRE(again.size() == before.size());
    for (const auto& [path, value] : before.items()) {
      INFO(path);
      if (value.is_number_float())
        CHECK(again.at(path).get<double>() == Approx(value.get<double>()).epsilon(1e-12).margin(1e-12));
      else
        CHECK(again.at(path) == value);
    }
  }
}

TEST_CASE("angles are in degrees and the ways of a misalignment in centimetres") {
  Status status;
  status.pairs.emplace_back();
  status.pairs[0].misalignment.emplace();
  status.pairs[0].misalignment->delta << 0, 0, radians_per_degree, 0, -0.02, 0;
  status.pairs[0].T_camera_lidar.translation() << 0, 0, 0.5;
  const json pair = to_json(status)["pairs"][0];
  CHECK(pair["misalignment"]["rotation_deg"][2].get<double>() == Approx(1));
  CHECK(pair["misalignment"]["translation_cm"][1].get<double>() == Approx(-2));
  CHECK(pair["T_camera_lidar"]["translation_m"] == json{0.0, 0.0, 0.5});
  CHECK(pair["T_camera_lidar"]["quaternion_xyzw"] == json{0.0, 0.0, 0.0, 1.0});
}

TEST_CASE("each axis states the motion of the LiDAR, its standard deviation, and whether it is observable") {
  Status status;
  PairStatus& pair = status.pairs.emplace_back();
  pair.misalignment.emplace();
  pair.misalignment->delta << -0.25 * radians_per_degree, 0, 0.62 * radians_per_degree, 0.031, -0.02, 0.0004;
  pair.misalignment->sigma << Eigen::Vector3d::Constant(0.05 * radians_per_degree), Eigen::Vector3d::Constant(0.012);
  pair.detection_limit.emplace(Vector6::Constant(0.002));
  (*pair.detection_limit)[4] = std::numeric_limits<double>::infinity();
  const json shown = to_json(status)["pairs"][0];
  CHECK(shown["axes"]["roll"] == "0.25 degrees left side down, sigma 0.05");
  CHECK(shown["axes"]["pitch"] == "0.00 degrees, sigma 0.05");
  CHECK(shown["axes"]["yaw"] == "0.62 degrees to the left, sigma 0.05");
  CHECK(shown["axes"]["x"] == "3.1 cm forward, sigma 1.2");
  CHECK(shown["axes"]["y"] == "not observable");
  CHECK(shown["axes"]["z"] == "0.0 cm, sigma 1.2");
  CHECK(shown["detection_limit"]["rotation_deg"][0].get<double>() == Approx(0.002 / radians_per_degree));
  CHECK(shown["detection_limit"]["translation_cm"][0].get<double>() == Approx(0.2));
  CHECK(shown["detection_limit"]["translation_cm"][1].is_null());
  // A snapshot of a calibd that did not say so yet.
  json earlier = to_json(status);
  earlier["pairs"][0].erase("detection_limit");
  earlier["pairs"][0].erase("axes");
  earlier["pairs"][0].erase("notice");
  CHECK_FALSE(require_ok(parse_status(earlier)).pairs[0].detection_limit);
}

TEST_CASE("what is not known is null, never zero") {
  Status status;
  status.pairs.emplace_back();
  const json pair = to_json(status)["pairs"][0];
  for (const char* field :
       {"last_evaluated", "score", "misalignment", "axes", "detection_limit", "proposed", "record"}) {
    INFO(field);
    CHECK(pair.at(field).is_null());
  }
  CHECK(pair["inputs"]["image"]["age_s"].is_null());
  CHECK(pair["inputs"]["time_difference_ms"].is_null());
  CHECK(pair["verdict"] == "not_evaluated");
}

TEST_CASE("a reader ignores fields that a newer calibd has added") {
  std::mt19937 random(2);
  json sent = to_json(random_status(random));
  sent["new"] = {1, 2, 3};
  sent["daemon"]["new"] = "x";
  for (json& pair : sent["pairs"]) pair["new"] = nullptr;
  CHECK(parse_status(sent));
}

TEST_CASE("a status with anything missing or of another kind is refused") {
  std::mt19937 random(3);
  Status status = random_status(random);
  status.pairs = {random_pair(random)};
  status.pairs[0].misalignment.emplace();
  status.pairs[0].proposed.emplace();
  status.pairs[0].record.emplace();
  status.pairs[0].score.emplace();
  const json good = to_json(status);
  const auto refused = [](const json& sent) {
    const auto read = parse_status(sent);
    return !read && read.error().code == "malformed_status";
  };
  CHECK_FALSE(refused(good));
  for (const json& sent : {json(), json(1), json::array(), json::object(), json("text")}) CHECK(refused(sent));
  const json fields = good.flatten();
  for (const auto& [path, value] : fields.items()) {
    if (path.find("right_image") != std::string::npos || path.find("/depth") != std::string::npos ||
        path.find("/motion") != std::string::npos || path.find("/skipped/") != std::string::npos ||
        path.find("/axes") != std::string::npos || path.find("/remarks") != std::string::npos ||
        path.find("/detection_limit") != std::string::npos || path == "/pairs/0/notice" ||
        path == "/pairs/0/evidence" || path.ends_with("/not_written") || path == "/records/missing" ||
        path == "/records/signing_refused")
      continue;
    INFO(path);
    const json::json_pointer pointer(path);
    json other = good;
    // Any word can be a cause that only a newer calibd knows.
    other[pointer] = value.is_string() || path == "/pairs/0/cause" ? json(1) : json("text");
    CHECK(refused(other));
    if (value.is_array() || pointer.back().find_first_not_of("0123456789") != std::string::npos) {
      json missing = good;
      missing[pointer.parent_pointer()].erase(pointer.back());
      CHECK(refused(missing));
    }
  }
}

TEST_CASE("remarks are told with their count and the last one; an earlier calibd has none") {
  std::mt19937 random(3);
  Status status = random_status(random);
  status.pairs = {random_pair(random)};
  status.pairs[0].remarks["malformed:row_step"] = {7, "/points: row_step is 0"};
  json sent = to_json(status);
  const Status read = require_ok(parse_status(sent));
  REQUIRE(read.pairs[0].remarks.size() == 1);
  CHECK(read.pairs[0].remarks.at("malformed:row_step").count == 7);
  CHECK(read.pairs[0].remarks.at("malformed:row_step").text == "/points: row_step is 0");
  sent["pairs"][0].erase("remarks");
  CHECK(require_ok(parse_status(sent)).pairs[0].remarks.empty());
  for (const json& wrong : {json(1), json{{"a", 1}}, json{{"a", {{"count", -1}, {"text", ""}}}}}) {
    sent["pairs"][0]["remarks"] = wrong;
    CHECK_FALSE(parse_status(sent));
  }
}

TEST_CASE("every verdict has a word, and every word its verdict") {
  for (const Verdict verdict : {Verdict::not_evaluated, Verdict::calibrated, Verdict::suspect, Verdict::drifted})
    CHECK(require_ok(parse_verdict(to_string(verdict))) == verdict);
  for (const char* text : {"", "Calibrated", "ok", "calibrated "}) CHECK_FALSE(parse_verdict(text));
}
