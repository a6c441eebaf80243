#include "calib/record.hpp"

#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>

#include "support/catch.hpp"
#include "support/records.hpp"

using namespace calib;
using namespace calib::test;
using Catch::Matchers::ContainsSubstring;

namespace {

std::string replaced(std::string text, const std::string& what, const std::string& with) {
  const auto at = text.find(what);
  if (at == std::string::npos) throw std::runtime_error("the record holds no " + what);
  return text.replace(at, what.size(), with);
}

/// A record with every field given but the baseline, numbers short.
CalibrationRecord full_record() {
  CalibrationRecord record;
  record.vehicle = "demo-car";
  record.pair = "front";
  record.sequence = 7;
  record.previous_sha256 = sha256_hex("six");
  record.decision = Decision::accepted;
  record.reason = "better on the pairs held back";
  record.asked_by = "calibd";
  record.T_camera_lidar.translation() << 0.25, -0.5, 1e-5;
  record.sigma = Vector6::Constant(0.125);
  record.score = CalibrationRecord::Score{1, 2, 3, 4};
  record.frame_stamps_ns = {1317046453072943000, -1, 0};
  record.configuration_sha256 = record.software_sha256 = sha256_hex("");
  record.software_version = "0.1.0";
  record.wall_time = std::chrono::nanoseconds(1769860800123456789);
  record.boot_id = "boot";
  record.boot_time = std::chrono::hours(24 * 365);
  return record;
}

CalibrationRecord baseline_record() {
  CalibrationRecord record = full_record();
  record.decision = Decision::baseline;
  record.baseline = CalibrationRecord::Baseline{.pairs = 20,
                                                .slope = Vector6::Constant(-0.5),
                                                .slope_covariance = 2 * Matrix6::Identity(),
                                                .slope_correlation = Vector6::Constant(0.25),
                                                .sensitivity = 8 * Matrix6::Identity(),
                                                .sensitivity_deviation = Vector6::Constant(1.5),
                                                .prominence = 0.25,
                                                .prominence_deviation = 0.0625,
                                                .prominence_correlation = 0.5,
                                                .score = 1.25,
                                                .score_deviation = 0.125};
  record.baseline->sensitivity(0, 1) = 3;  // not symmetric
  return record;
}

bool verifies(const SignedRecord& record, const PublicKey& key, const std::vector<SignedRecord>& before) {
  const std::string previous = before.empty() ? std::string(no_previous_sha256) : sha256_hex(before.back().canonical);
  return verify_record(record, key, previous, before.size() + 1).has_value();
}

}  // namespace

TEST_CASE("the canonical bytes of a record are the documented ones") {
  const std::string zeros_and_one = R"("quaternion_xyzw":[0.0,0.0,0.0,1.0])";
  // clang-format off
  CHECK(canonical_bytes(full_record()) ==
        R"({"T_camera_lidar":{)" + zeros_and_one + R"(,"translation_m":[0.25,-0.5,1e-05]},)"
        R"("T_camera_lidar_before":{)" + zeros_and_one + R"(,"translation_m":[0.0,0.0,0.0]},)"
        R"("asked_by":"calibd","boot_id":"boot","boot_time_ns":"31536000000000000",)"
        R"("configuration_sha256":"e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855",)"
        R"("decision":"accepted","frame_stamps_ns":["1317046453072943000","-1","0"],"pair":"front",)"
        R"("previous_sha256":")" + sha256_hex("six") + R"(","reason":"better on the pairs held back","schema":1,)"
        R"("score":{"after":2.0,"before":1.0,"held_back_after":4.0,"held_back_before":3.0},"sequence":7,)"
        R"("sigma":{"rotation_rad":[0.125,0.125,0.125],"translation_m":[0.125,0.125,0.125]},)"
        R"("software_sha256":"e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855",)"
        R"("software_version":"0.1.0","vehicle":"demo-car","wall_time":"2026-01-31T12:00:00.123456789Z"})");
  // clang-format on
}

TEST_CASE("records of earlier schemas are read, one of a later schema is refused by its number") {
  CalibrationRecord record = full_record();
  const std::string schema_1 = canonical_bytes(record);
  record.evidence_sha256 = sha256_hex("evidence");
  const std::string schema_2 = canonical_bytes(record);
  CHECK(require_ok(parse_record(schema_1)).evidence_sha256.empty());
  CHECK(require_ok(parse_record(schema_2)).evidence_sha256 == record.evidence_sha256);
  for (const std::string number : {"0", "4", "18446744073709551615"}) {
    const auto refused = parse_record(replaced(schema_2, R"("schema":2)", R"("schema":)" + number));
    REQUIRE_FALSE(refused);
    CHECK(refused.error().code == "malformed_record");
    CHECK_THAT(refused.error().context, ContainsSubstring("of schema " + number + ", and this program knows 1 to 3"));
  }
}

TEST_CASE("the digest of the evidence makes it schema 2, and is required there") {
  CalibrationRecord record = full_record();
  record.evidence_sha256 = sha256_hex("evidence");
  const std::string text = canonical_bytes(record);
  const std::string digest = R"("evidence_sha256":")" + sha256_hex("evidence") + R"(",)";
  CHECK_THAT(text, ContainsSubstring(digest));
  CHECK_THAT(text, ContainsSubstring(R"("schema":2,)"));
  CHECK(require_ok(parse_record(text)).evidence_sha256 == sha256_hex("evidence"));
  for (const std::string& bad :
       {replaced(text, R"("schema":2)", R"("schema":1)"), replaced(text, digest, ""),
        replaced(text, sha256_hex("evidence"), ""), replaced(text, R"("schema":2)", R"("schema":3)")})
    CHECK_FALSE(parse_record(bad));
}

TEST_CASE("a comment makes it schema 3, with the login of who made it; without one the bytes are as before") {
  CalibrationRecord record = full_record();
  record.evidence_sha256 = sha256_hex("evidence");
  const std::string schema_2 = canonical_bytes(record);
  record.comment.login = "uid:1000";
  CHECK(canonical_bytes(record) == schema_2);
  record.comment.text = "bracket replaced, \"left\" \\ ä 🚗";
  const std::string text = canonical_bytes(record);
  CHECK_THAT(text, ContainsSubstring(R"("comment":"bracket replaced, \"left\" \\ ä 🚗",)"));
  CHECK_THAT(text, ContainsSubstring(R"("login":"uid:1000",)"));
  CHECK_THAT(text, ContainsSubstring(R"("schema":3,)"));
  const CalibrationRecord read = require_ok(parse_record(text));
  CHECK(read.comment.text == record.comment.text);
  CHECK(read.comment.login == "uid:1000");
  CHECK(read.evidence_sha256 == record.evidence_sha256);
  record.comment.login.clear();
  CHECK_THAT(canonical_bytes(record), ContainsSubstring(R"("login":null,)"));
  CHECK(parse_record(canonical_bytes(record)));
  for (const std::string& bad :
       {replaced(text, R"("schema":3)", R"("schema":2)"), replaced(text, R"("login":"uid:1000",)", ""),
        replaced(text, R"("uid:1000")", R"("")"), replaced(text, "bracket", "bra\\nket"),
        replaced(text, "bracket", std::string(longest_comment, 'x')),
        replaced(schema_2, R"("schema":2)", R"("schema":3)"),
        replaced(text, R"("evidence_sha256":")" + sha256_hex("evidence") + R"(",)", "")}) {
    INFO(bad);
    CHECK_FALSE(parse_record(bad));
  }
}

TEST_CASE("a comment is one line of text, of a thousand bytes at most") {
  for (const std::string& good :
       {std::string("x"), std::string("Ä 路 🚗"), std::string("a\\b \"c\""), std::string(longest_comment, 'x')})
    CHECK(check_comment(good));
  for (const std::string& bad : {std::string(), std::string(longest_comment + 1, 'x'), std::string("a\nb"),
                                 std::string("a\tb"), std::string("\x1b[31m"), std::string("\x7f"), std::string("\xff"),
                                 std::string(1, '\0'), std::string("\u009b2J"), std::string("\u202e")}) {
    const auto refused = check_comment(bad);
    REQUIRE_FALSE(refused);
    CHECK(refused.error().code == "bad_request");
  }
}

TEST_CASE("a baseline is a field of its record alone, matrices by rows") {
  const std::string six = "[-0.5,-0.5,-0.5,-0.5,-0.5,-0.5]";
  const std::string text = canonical_bytes(baseline_record());
  CHECK_THAT(
      text,
      ContainsSubstring(
          R"("asked_by":"calibd","baseline":{"pairs":20,"peak":0.25,"peak_correlation":0.5,"peak_deviation":0.0625,"response":[[8.0,3.0,0.0,0.0,0.0,0.0],)"
          R"([0.0,8.0,0.0,0.0,0.0,0.0],)"));
  CHECK_THAT(text, ContainsSubstring(R"("score":1.25,"score_deviation":0.125,"slope":)" + six +
                                     R"(,"slope_correlation":[0.25,)"));
  CHECK_THAT(text, ContainsSubstring(R"("decision":"baseline")"));
  const CalibrationRecord read = require_ok(parse_record(text));
  CHECK(read.baseline->sensitivity(0, 1) == 3);
  CHECK(read.baseline->sensitivity(1, 0) == 0);
  for (const std::string& bad : {
           replaced(text, R"("decision":"baseline")", R"("decision":"accepted")"),
           replaced(text, R"("pairs":20)", R"("pairs":1)"),
           replaced(text, R"("pairs":20)", R"("pairs":20.0)"),
           replaced(text, R"("pairs":20,)", ""),
           replaced(text, R"("pairs":20)", R"("pairs":20,"q":1)"),
           replaced(text, R"([[8.0,3.0,)", R"([[8.0,3,)"),
           replaced(text, R"([[8.0,3.0,)", R"([[8.0,)"),
           replaced(text, R"("response":[[8.0,3.0,0.0,0.0,0.0,0.0],)", R"("response":[)"),
           replaced(text, R"("slope_covariance":[[2.0,0.0)", R"("slope_covariance":[[2.0,1.0)"),
           replaced(text, R"("slope_covariance":[[2.0)", R"("slope_covariance":[[-2.0)"),
           replaced(text, R"("score_deviation":0.125)", R"("score_deviation":-0.125)"),
           replaced(text, R"("peak_deviation":0.0625)", R"("peak_deviation":-0.0625)"),
           replaced(canonical_bytes(full_record()), R"("decision":"accepted")", R"("decision":"baseline")"),
       }) {
    INFO(bad);
    CHECK_FALSE(parse_record(bad));
  }
}

TEST_CASE("what puts an extrinsic in force") {
  for (const Decision decision : {Decision::initial, Decision::accepted, Decision::rolled_back})
    CHECK(puts_in_force(decision));
  for (const Decision decision : {Decision::proposed, Decision::rejected, Decision::baseline})
    CHECK_FALSE(puts_in_force(decision));
}

TEST_CASE("any record comes back from its canonical bytes") {
  std::mt19937 random(1);
  for (int i = 0; i < 5'000; ++i) {
    const CalibrationRecord record = random_record(random);
    const std::string bytes = canonical_bytes(record);
    INFO(bytes);
    const CalibrationRecord read = require_ok(parse_record(bytes));
    CHECK(read.vehicle == record.vehicle);
    CHECK(read.pair == record.pair);
    CHECK(read.sequence == record.sequence);
    CHECK(read.previous_sha256 == record.previous_sha256);
    CHECK(read.decision == record.decision);
    CHECK(read.reason == record.reason);
    CHECK(read.asked_by == record.asked_by);
    CHECK(read.T_camera_lidar.isApprox(record.T_camera_lidar, 1e-14));
    CHECK(read.T_camera_lidar_before.isApprox(record.T_camera_lidar_before, 1e-14));
    CHECK(read.sigma == record.sigma);
    REQUIRE(read.score.has_value() == record.score.has_value());
    if (record.score) {
      CHECK(read.score->before == record.score->before);
      CHECK(read.score->after == record.score->after);
      CHECK(read.score->held_back_before == record.score->held_back_before);
      CHECK(read.score->held_back_after == record.score->held_back_after);
    }
    REQUIRE(read.baseline.has_value() == (record.decision == Decision::baseline));
    if (record.baseline) {
      CHECK(read.baseline->pairs == record.baseline->pairs);
      CHECK(read.baseline->slope == record.baseline->slope);
      CHECK(read.baseline->slope_covariance == record.baseline->slope_covariance);
      CHECK(read.baseline->slope_correlation == record.baseline->slope_correlation);
      CHECK(read.baseline->sensitivity == record.baseline->sensitivity);
      CHECK(read.baseline->sensitivity_deviation == record.baseline->sensitivity_deviation);
      CHECK(read.baseline->score == record.baseline->score);
      CHECK(read.baseline->score_deviation == record.baseline->score_deviation);
      CHECK(read.baseline->prominence == record.baseline->prominence);
      CHECK(read.baseline->prominence_deviation == record.baseline->prominence_deviation);
      CHECK(read.baseline->prominence_correlation == record.baseline->prominence_correlation);
    }
    CHECK(read.frame_stamps_ns == record.frame_stamps_ns);
    CHECK(read.configuration_sha256 == record.configuration_sha256);
    CHECK(read.software_version == record.software_version);
    CHECK(read.software_sha256 == record.software_sha256);
    CHECK(read.wall_time == record.wall_time);
    CHECK(read.boot_id == record.boot_id);
    CHECK(read.boot_time == record.boot_time);
  }
}

TEST_CASE("a text that is not the canonical form of a record is refused") {
  const std::string good = canonical_bytes(full_record());
  CHECK(parse_record(good));
  const std::vector<std::string> bad{
      "",
      "{}",
      "[]",
      "null",
      "1",
      "{",
      std::string(100'000, '['),
      good + "\n",
      " " + good,
      replaced(good, R"("pair":"front",)", ""),                               // missing
      replaced(good, R"("pair":"front",)", R"("pair":"front","q":1,)"),       // unknown
      replaced(good, R"("pair":"front",)", R"("pair":"x","pair":"front",)"),  // twice
      replaced(good, R"("pair":"front")", R"("pair":"\u0066ront")"),          // another way to write it
      replaced(good, R"("pair":"front")", R"("pair":7)"),
      replaced(good, R"("pair":"front")", R"("pair": "front")"),
      replaced(good, R"("pair":"front")", "\"pair\":\"fr\xffnt\""),
      replaced(good, "[0.25,-0.5,1e-05]", "[0.25,-0.5,0.00001]"),
      replaced(good, "[0.25,-0.5,1e-05]", "[0.25,-0.5,1e-5]"),
      replaced(good, "[0.25,-0.5,1e-05]", "[0.25,-0.5]"),
      replaced(good, "[0.25,-0.5,1e-05]", "[0.25,-0.5,null]"),
      replaced(good, "[0.25,-0.5,1e-05]", "[0.25,-0.5,1e999]"),
      replaced(good, "[0.0,0.0,0.0,1.0]", "[0,0.0,0.0,1.0]"),
      replaced(good, "[0.0,0.0,0.0,1.0]", "[0.0,0.0,0.0,0.5]"),
      replaced(good, R"("sequence":7)", R"("sequence":0)"),
      replaced(good, R"("sequence":7)", R"("sequence":-7)"),
      replaced(good, R"("sequence":7)", R"("sequence":7.0)"),
      replaced(good, R"("schema":1)", R"("schema":2)"),
      replaced(good, R"("schema":1)", R"("schema":1.0)"),
      replaced(good, R"("accepted")", R"("approved")"),
      replaced(good, R"("after":2.0)", R"("after":2)"),
      replaced(good, R"("after":2.0)", R"("after":null)"),
      replaced(good, R"("-1")", R"("-01")"),
      replaced(good, R"("-1")", R"("")"),
      replaced(good, R"("-1")", "-1"),
      replaced(good, R"("-1")", R"("99999999999999999999")"),
      replaced(good, sha256_hex("six"), "6"),
      replaced(good, "e3b0c442", "E3B0C442"),
      replaced(good, "12:00:00.123456789Z", "12:00:00.123456780Z ").erase(0, 1),
      replaced(good, "12:00:00.123456789Z", "12:00:00.123Z"),
      replaced(good, "2026-01-31", "2026-02-31"),
  };
  for (const std::string& text : bad) {
    INFO(text.substr(0, 2000));
    const auto read = parse_record(text);
    REQUIRE_FALSE(read);
    CHECK(read.error().code == "malformed_record");
  }
}

TEST_CASE("a record that could not be read back is not signed") {
  const SigningKey key = SigningKey::generate();
  const auto refused = [&](const std::function<void(CalibrationRecord&)>& spoil) {
    CalibrationRecord record = full_record();
    spoil(record);
    const auto is_signed = sign_record(record, key);
    return !is_signed && is_signed.error().code == "malformed_record";
  };
  CHECK(refused([](auto& r) { r.score->after = std::numeric_limits<double>::quiet_NaN(); }));
  CHECK(refused([](auto& r) { (*r.sigma)[5] = std::numeric_limits<double>::infinity(); }));
  CHECK(refused([](auto& r) { r.T_camera_lidar.translation().x() = std::nan(""); }));
  CHECK(refused([](auto& r) { r.sequence = 0; }));
  CHECK(refused([](auto& r) { r.decision = Decision::baseline; }));
  CHECK(refused([](auto& r) { r.baseline = baseline_record().baseline; }));
  CHECK(refused([](auto& r) {
    r = baseline_record();
    r.baseline->sensitivity(3, 4) = std::nan("");
  }));
  CHECK(refused([](auto& r) { r.previous_sha256.clear(); }));
  CHECK(refused([](auto& r) { r.software_sha256 = "unknown"; }));
  CHECK_FALSE(refused([](auto& r) { r.reason = "not \xff UTF-8"; }));
}

TEST_CASE("every single-bit change of a signed record is detected") {
  std::mt19937 random(2);
  const SigningKey key = SigningKey::generate();
  const PublicKey public_key = key.public_key();
  const SignedRecord good = sign_next(random_record(random), {}, key);
  REQUIRE(verifies(good, public_key, {}));
  for (std::size_t bit = 0; bit < 8 * good.canonical.size(); ++bit) {
    SignedRecord bad = good;
    bad.canonical[bit / 8] = static_cast<char>(bad.canonical[bit / 8] ^ (1 << bit % 8));
    INFO("bit " << bit << " of the record");
    REQUIRE_FALSE(verifies(bad, public_key, {}));
  }
  // Nothing covers the text of the untrusted comment, the first line of a signature file.
  for (std::size_t bit = 8 * good.signature.find('\n'); bit < 8 * good.signature.size(); ++bit) {
    SignedRecord bad = good;
    bad.signature[bit / 8] = static_cast<char>(bad.signature[bit / 8] ^ (1 << bit % 8));
    INFO("bit " << bit << " of the signature");
    REQUIRE_FALSE(verifies(bad, public_key, {}));
  }
}

TEST_CASE("a record that is cut short or lengthened is detected") {
  std::mt19937 random(3);
  const SigningKey key = SigningKey::generate();
  const SignedRecord good = sign_next(random_record(random), {}, key);
  for (std::size_t length = 0; length < good.canonical.size(); ++length)
    REQUIRE_FALSE(verifies({good.canonical.substr(0, length), good.signature}, key.public_key(), {}));
  CHECK_FALSE(verifies({good.canonical + " ", good.signature}, key.public_key(), {}));
  CHECK_FALSE(verifies({good.canonical, ""}, key.public_key(), {}));
}

TEST_CASE("a record of another key, or with another's signature, does not verify") {
  std::mt19937 random(5);
  const SigningKey key = SigningKey::generate(), other = SigningKey::generate();
  const SignedRecord record = sign_next(random_record(random), {}, key);
  const auto verified = verify_record(record, other.public_key(), no_previous_sha256, 1);
  REQUIRE_FALSE(verified);
  CHECK(verified.error().code == "wrong_key");
  CHECK_THAT(verified.error().context, ContainsSubstring(key.public_key().id_text()));
  const SignedRecord another = sign_next(random_record(random), {}, key);
  CHECK(verify_record({record.canonical, another.signature}, key.public_key(), no_previous_sha256, 1).error().code ==
        "bad_signature");
}

TEST_CASE("signing a record twice gives the same file, which names it") {
  const SigningKey key = SigningKey::generate();
  const SignedRecord once = require_ok(sign_record(full_record(), key));
  CHECK(once.signature == require_ok(sign_record(full_record(), key)).signature);
  CHECK_THAT(once.signature, ContainsSubstring("\ntrusted comment: timestamp:1769860800\tfile:000007.json\thashed\n"));
  CHECK(record_file_name(12'345'678) == "12345678.json");
}

TEST_CASE("SHA-256 is the one that FIPS 180-4 defines") {
  CHECK(sha256_hex("abc") == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
}
