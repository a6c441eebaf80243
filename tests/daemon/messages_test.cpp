#include "dds/messages.hpp"

#include <cmath>
#include <limits>
#include <map>
#include <vector>

#include "support/catch.hpp"

using namespace calib;
using namespace std::chrono_literals;

namespace {

constexpr WallTime stamp = 1'700'000'000s + 5ns;

PairStatus pair(Verdict verdict, const std::string& reason = "") {
  PairStatus pair;
  pair.name = "front";
  pair.verdict = verdict;
  pair.reason = reason;
  pair.image.topic = "/left/image";
  pair.cloud.topic = "/points";
  return pair;
}

Status status(const std::vector<PairStatus>& pairs) {
  Status status;
  status.vehicle = "car";
  status.pairs = pairs;
  return status;
}

/// The values of the first pair of a message.
std::map<std::string, std::string> values(const DiagnosticArrayMessage& message) {
  std::map<std::string, std::string> values;
  const auto& sent = message->status._buffer[0].values;
  for (std::uint32_t i = 0; i < sent._length; ++i) values[sent._buffer[i].key] = sent._buffer[i].value;
  return values;
}

}  // namespace

TEST_CASE("each verdict has its level of diagnostics") {
  const std::pair<Verdict, int> levels[] = {
      {Verdict::calibrated, 0}, {Verdict::suspect, 1}, {Verdict::drifted, 2}, {Verdict::not_evaluated, 3}};
  for (const auto& [verdict, level] : levels) {
    const auto message = diagnostics_message(status({pair(verdict)}), stamp);
    REQUIRE(message->status._length == 1);
    CHECK(message->status._buffer[0].level == level);
    CHECK(message->status._buffer[0].message == to_string(verdict));
  }
}

TEST_CASE("diagnostics hold one status per pair, with vehicle, reason and time") {
  const auto message =
      diagnostics_message(status({pair(Verdict::calibrated), pair(Verdict::not_evaluated, "no image")}), stamp);
  CHECK((message->header.stamp.sec == 1'700'000'000 && message->header.stamp.nanosec == 5));
  REQUIRE(message->status._length == 2);
  const auto& second = message->status._buffer[1];
  CHECK(second.name == std::string("calibd: front"));
  CHECK(second.hardware_id == std::string("car"));
  CHECK(second.message == std::string("not_evaluated: no image"));
  CHECK(diagnostics_message(status({}), stamp)->status._length == 0);
}

TEST_CASE("values of diagnostics are in degrees and centimetres, and name their unit") {
  PairStatus shifted = pair(Verdict::drifted);
  shifted.misalignment = PairStatus::Misalignment{};
  shifted.misalignment->delta[2] = radians_per_degree;
  shifted.misalignment->sigma[3] = 0.02;
  shifted.time_difference_ms = 12.34;
  shifted.skipped = {{"dark", 3}};
  shifted.image.age_s = 0.25;
  const auto sent = values(diagnostics_message(status({shifted}), stamp));
  CHECK(sent.at("verdict") == "drifted");
  CHECK(sent.at("misalignment yaw [deg]") == "1.000");
  CHECK(sent.at("sigma x [cm]") == "2.000");
  CHECK(sent.at("time difference [ms]") == "12.3");
  CHECK(sent.at("skipped dark") == "3");
  CHECK(sent.at("image topic") == "/left/image");
  CHECK(sent.at("image age [s]") == "0.2");
  CHECK_FALSE(sent.contains("cloud age [s]"));
  CHECK_FALSE(sent.contains("depth topic"));
}

TEST_CASE("text in a message has no control characters and no zero bytes") {
  PairStatus odd = pair(Verdict::suspect, std::string("a\x1b[31m\0b", 8));
  odd.image.topic = "/\x07";
  const auto message = diagnostics_message(status({odd}), stamp);
  const std::string reason = message->status._buffer[0].message;
  CHECK(reason.find('\x1b') == std::string::npos);
  CHECK(reason.ends_with('b'));
  CHECK(values(message).at("image topic").find('\x07') == std::string::npos);
}

TEST_CASE("a proposed extrinsic is a transform from the camera's frame to the LiDAR's") {
  ProposedExtrinsic proposed{"camera_front", "lidar_top", RigidTransform::Identity()};
  proposed.T_camera_lidar.translation() = Eigen::Vector3d(1, 2, 3);
  const auto message = transforms_message(std::vector{proposed}, stamp);
  REQUIRE(message->transforms._length == 1);
  const auto& sent = message->transforms._buffer[0];
  CHECK(sent.header.frame_id == std::string("camera_front"));
  CHECK(sent.child_frame_id == std::string("lidar_top"));
  CHECK(sent.header.stamp.nanosec == 5);
  CHECK((sent.transform.translation.x == 1 && sent.transform.translation.z == 3));
  CHECK((sent.transform.rotation.x == 0 && sent.transform.rotation.w == 1));
  CHECK(transforms_message({}, stamp)->transforms._length == 0);
}

TEST_CASE("an alert is in radians and metres, rotation before translation") {
  DriftAlert alert{.stamp = -1ns,
                   .alert_sequence = 7,
                   .vehicle = "car",
                   .pair = "front",
                   .verdict = Verdict::drifted,
                   .previous_verdict = Verdict::calibrated,
                   .reason = "yaw",
                   .misalignment = {},
                   .record_sequence = 9};
  for (int i = 0; i < 6; ++i) alert.misalignment.delta[i] = i, alert.misalignment.sigma[i] = 10 + i;
  alert.misalignment.sigma[5] = std::numeric_limits<double>::infinity();
  const auto message = drift_alert_message(alert);
  CHECK((message->stamp.sec == -1 && message->stamp.nanosec == 999'999'999));
  CHECK((message->alert_sequence == 7 && message->record_sequence == 9));
  CHECK(message->verdict == std::string("drifted"));
  CHECK(message->previous_verdict == std::string("calibrated"));
  CHECK((message->rotation_rad[2] == 2 && message->translation_m[0] == 3));
  CHECK((message->sigma_rotation_rad[0] == 10 && message->sigma_translation_m[1] == 14));
  CHECK(std::isinf(message->sigma_translation_m[2]));
}
