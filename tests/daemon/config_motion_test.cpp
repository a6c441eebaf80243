#include <cstdlib>
#include <fstream>
#include <iterator>

#include "config.hpp"
#include "support/catch.hpp"
#include "support/support.hpp"

using namespace calib;
using namespace calib::test;

namespace {

/// A configuration whose last line, the eighth, is `motion: {mapping}`.
Result<Config> parse(const std::string& mapping) {
  return parse_config(
      "vehicle: car\npairs:\n  - name: front\n    camera: {image: /l, size: [640, 480], intrinsics: [500, 500, 320, "
      "240], model: rectified}\n    lidar: {cloud: /p}\n    T_camera_lidar: {translation_m: [0, 0, 0], "
      "quaternion_xyzw: [0, 0, 0, 1]}\n    depth: {source: topic, image: /d}\n    motion: {" +
          mapping + "}\n",
      "c.yaml", {"/state", "/runtime", "/credentials"});
}

}  // namespace

TEST_CASE("motion comes from an IMU or from odometry; its limit has a default") {
  const auto imu = require_ok(parse("topic: /imu/data, type: imu")).pairs[0].motion;
  REQUIRE(imu);
  CHECK((imu->topic.name == "/imu/data" && imu->topic.message == MotionMessage::imu));
  CHECK(imu->max_turn_rad == QualityLimits{}.max_turn_rad);
  CHECK(imu->max_turn_rad == Approx(0.1 * radians_per_degree));
  const auto odometry = require_ok(parse("topic: dds:Odometry, type: odometry, max_turn_deg: 0.25")).pairs[0].motion;
  CHECK((odometry->topic.name == "dds:Odometry" && odometry->topic.message == MotionMessage::odometry));
  CHECK(odometry->max_turn_rad == Approx(0.25 * radians_per_degree));
}

TEST_CASE("an error in motion is reported with its line, key and remedy") {
  const std::pair<const char*, const char*> refusals[] = {
      {"type: imu", "topic: missing; add it"},
      {"topic: /imu", "type: missing; add it"},
      {"topic: imu, type: imu", "topic: a topic is written as ROS 2 does"},
      {"topic: /imu, type: gyro", "type: is none of: imu, odometry"},
      {"topic: /imu, type: imu, max_turn_deg: 0", "max_turn_deg: 0 is outside 0.01 .. 10"},
      {"topic: /imu, type: imu, max_turn_deg: 0.1 deg", "max_turn_deg: "},
      {"topic: /imu, type: imu, max_yaw_deg: 1", "max_yaw_deg: unknown key"},
  };
  for (const auto& [mapping, words] : refusals) {
    INFO(mapping);
    const auto config = parse(mapping);
    REQUIRE_FALSE(config);
    CHECK_THAT(config.error().context, Catch::Matchers::StartsWith("c.yaml:8: pairs[0].motion." + std::string(words)));
  }
}

TEST_CASE("the motion that the example in systemd/ comments out is valid") {
  std::ifstream in(std::filesystem::path(std::getenv("CALIBD_SOURCE_DIR")) / "systemd" / "calibd.yaml");
  std::string example{std::istreambuf_iterator<char>(in), {}};
  const auto begin = example.find("    # motion:"), end = example.find("    drift:");
  REQUIRE((begin != std::string::npos && begin < end));
  const DefaultFolders places{"/state", "/runtime", "/credentials"};
  CHECK_FALSE(require_ok(parse_config(example, "c.yaml", places)).pairs[0].motion);
  for (auto at = begin; at < example.find("    drift:"); at = example.find('\n', at) + 1) example.erase(at + 4, 2);
  INFO(example.substr(begin, 400));
  CHECK(require_ok(parse_config(example, "c.yaml", places)).pairs[0].motion->topic.name == "/imu/data");
}
