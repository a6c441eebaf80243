#include "service.hpp"
#include "support/catch.hpp"
#include "support/pair_scenario.hpp"

using namespace calib;
using namespace calib::test;
using namespace std::chrono_literals;

namespace {

/// A CameraInfo of the camera, or of one with another focal length, as the last sample of a window.
World told(const PairScenario& scenario, double focal_length_factor) {
  const Camera& camera = scenario.camera();
  CameraInfo info{.width = camera.width(), .height = camera.height()};
  info.K = {
      camera.fx() * focal_length_factor, 0, camera.cx(), 0, camera.fy() * focal_length_factor, camera.cy(), 0, 0, 1};
  return {.sent = [info](std::vector<Sample>& sent) { sent.emplace_back(info); }};
}

template <typename Sent>
World with(void (*change)(Sent&)) {
  return {.sent = [change](std::vector<Sample>& all) {
    for (Sample& sample : all)
      if (auto* sent = std::get_if<Sent>(&sample)) change(*sent);
  }};
}

}  // namespace

TEST_CASE("while the last CameraInfo contradicts the configuration nothing is evaluated, whatever comes first") {
  PairScenario scenario({.camera_info = true});
  scenario.drive(1, told(scenario, 1));
  const std::uint64_t evaluated = scenario.state().evaluated;
  scenario.drive(2);  // from windows in which none comes, too
  CHECK(scenario.state().evaluated == evaluated + 2);

  scenario.drive(1, told(scenario, 1.2));  // behind the pair in its window
  const std::uint64_t before = scenario.state().evaluated;
  scenario.drive(5);
  CHECK(scenario.state().evaluated == before);
  CHECK(scenario.status().verdict == Verdict::not_evaluated);
  CHECK_THAT(scenario.status().reason, Catch::Matchers::ContainsSubstring("CameraInfo's K has ["));

  scenario.drive(1, told(scenario, 1));
  scenario.drive(1);
  CHECK(scenario.state().evaluated == before + 2);
}

TEST_CASE("the first CameraInfo is waited for, so that none contradicts what was evaluated already") {
  PairScenario scenario({.learned = false, .camera_info = true});
  scenario.drive(4, told(scenario, 1.2));
  CHECK(scenario.state().evaluated == 0);
}

TEST_CASE("a CameraInfo that never comes costs three windows, and a remark") {
  PairScenario scenario({.learned = false, .camera_info = true});
  scenario.drive(5);
  CHECK(scenario.state().evaluated == 5);
  const auto remarks = scenario.status().remarks;
  REQUIRE(remarks.count("camera_info_missing") == 1);
  CHECK(remarks.at("camera_info_missing").count == 1);
  CHECK_THAT(remarks.at("camera_info_missing").text, Catch::Matchers::StartsWith("/info: no CameraInfo came"));
}

TEST_CASE("what was wrong in a message that was used is counted as a remark, and named with its topic") {
  PairScenario scenario;
  const std::uint64_t evaluated = scenario.state().evaluated;
  scenario.drive(3, with<DecodedCloud>(+[](DecodedCloud& cloud) {
                   cloud.notes.remarks.push_back({ErrorCode::malformed_row_step, "row_step is \x1b"});
                 }));
  CHECK(scenario.state().evaluated == evaluated + 3);
  const auto remarks = scenario.status().remarks;
  REQUIRE(remarks.size() == 1);
  CHECK(remarks.at("malformed:row_step").count == 3);
  CHECK(remarks.at("malformed:row_step").text == "/cloud: row_step is \\x1b");
}

TEST_CASE("a proposed extrinsic names the frames of the messages, unless the configuration names others") {
  const auto frames = with<DecodedCloud>(+[](DecodedCloud& cloud) { cloud.notes.frame_id = "os_lidar"; });
  const auto images = with<LeftImage>(+[](LeftImage& left) { left.image.notes.frame_id = "cam_front/optical"; });
  const auto propose = [&](PairScenario& scenario) {
    scenario.drive(1, frames);
    scenario.drive(1, images);
    REQUIRE(scenario.drive_until(Verdict::drifted, 100, {.motion = moved(0, 0, 3)}) < 100);
    for (int i = 0; i < 60 && scenario.proposed().empty(); ++i) scenario.drive(1, {.motion = moved(0, 0, 3)});
    REQUIRE(scenario.proposed().size() == 1);
    return scenario.proposed()[0].camera_frame + " " + scenario.proposed()[0].lidar_frame;
  };
  PairScenario scenario({.mode = RecalibrationMode::propose});
  CHECK(propose(scenario) == "cam_front/optical os_lidar");
  CHECK(scenario.status().remarks.empty());

  PairScenario other({.mode = RecalibrationMode::propose, .camera_frame = {"camera", "camera.frame_id", true}});
  CHECK(propose(other) == "camera os_lidar");
  CHECK(other.status().remarks.at("frame_id_mismatch").text ==
        "/image has the frame 'cam_front/optical', and camera.frame_id is 'camera'");
}
