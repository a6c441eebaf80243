#include "depth_source.hpp"

#include "support/catch.hpp"
#include "support/support.hpp"
#include "vehicle/rig.hpp"

using namespace calib;
using namespace calib::test;
using namespace std::chrono_literals;

namespace {

constexpr int width = 480, height = 144;

/// As a stereo calibration tells it.
CameraInfo info(const vehicle::Rig& rig, bool right) {
  const Camera& camera = rig.camera;
  CameraInfo info{.width = camera.width(),
                  .height = camera.height(),
                  .model = camera.model(),
                  .K = {camera.fx(), 0, camera.cx(), 0, camera.fy(), camera.cy(), 0, 0, 1},
                  .D = camera.distortion(),
                  .P = {camera.fx(), 0, camera.cx(), right ? -camera.fx() * rig.baseline_m : 0, 0, camera.fy(),
                        camera.cy(), 0, 0, 0, 1, 0},
                  .R = {}};
  Eigen::Map<Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(info.R.data()) =
      right ? rig.R_rectified_right : rig.R_rectified_left;
  return info;
}

double distance(const RigidTransform& a, const RigidTransform& b) { return (a.matrix() - b.matrix()).norm(); }

/// A pair whose two images, of this size, are noise: depth is as much work as of any other.
struct Noise {
  PairConfig config{.name = "front",
                    .camera = {.image = "/l", .info = {}, .camera = require_ok(vehicle::Rig::make(1600, 1200)).camera},
                    .lidar = {},
                    .T_camera_lidar = RigidTransform::Identity(),
                    .depth = {},
                    .depth_range = {},
                    .drift = {},
                    .recalibration = {}};
  FramePair pair{.image = {{}, 1600, 1200, std::vector<std::uint8_t>(1600 * 1200)}, .right_image = {}, .scan = {}};

  Noise() {
    unsigned random = 1;
    for (auto& pixel : pair.image.pixels)
      pixel = static_cast<std::uint8_t>((random = random * 1664525 + 1013904223) >> 24);
    pair.right_image = pair.image;
    StereoDepthConfig stereo{
        .right_image = "/r", .right_camera = rectified_right_camera(config.camera.camera, 0.5), .right_info = {}};
    config.depth = stereo;
  }
};

}  // namespace

TEST_CASE("the right camera follows from both CameraInfo") {
  const auto rig = require_ok(vehicle::Rig::make_unrectified(width, height));
  const auto right = require_ok(right_camera(rig.camera, {info(rig, false), info(rig, true)}));
  CHECK(distance(right.T_right_left, rig.T_left_right().inverse()) < 1e-12);
  CHECK(right.camera.model() == CameraModel::plumb_bob);
  CHECK(right.camera.distortion() == rig.camera.distortion());

  const auto straight = require_ok(vehicle::Rig::make(width, height));
  const auto beside = require_ok(right_camera(straight.camera, {{}, info(straight, true)}));
  CHECK(distance(beside.T_right_left, RigidTransform(Eigen::Translation3d(-straight.baseline_m, 0, 0))) < 1e-12);
  CHECK(beside.camera.model() == CameraModel::rectified);
  CameraInfo digits = info(straight, true);
  digits.P[0] += 1e-4;
  CHECK(require_ok(right_camera(straight.camera, {{}, digits})).camera.fx() == straight.camera.fx());
  digits.P[2] += 5;  // the two pictures are not of the same directions
  CHECK(require_ok(right_camera(straight.camera, {{}, digits})).camera.cx() == straight.camera.cx() + 5);
}

TEST_CASE("CameraInfo of cameras that are not calibrated as a pair is refused with a remedy") {
  const auto rig = require_ok(vehicle::Rig::make_unrectified(width, height));
  const auto refusal = [&](auto spoil) {
    CameraInfo left = info(rig, false), right = info(rig, true);
    spoil(left, right);
    const auto made = right_camera(rig.camera, {left, right});
    REQUIRE_FALSE(made);
    CHECK(made.error().code == "bad_camera");
    CHECK_THAT(made.error().context, Catch::Matchers::EndsWith("calibrate the stereo camera, or give right_camera"));
    return made.error().context;
  };
  CHECK_THAT(refusal([](CameraInfo&, CameraInfo& right) { right.P[3] = 0; }),
             Catch::Matchers::ContainsSubstring("no baseline"));
  CHECK_THAT(refusal([](CameraInfo&, CameraInfo& right) { right.P.fill(0); }),
             Catch::Matchers::ContainsSubstring("no baseline"));
  CHECK_THAT(refusal([](CameraInfo& left, CameraInfo&) { left.R.fill(0); }),
             Catch::Matchers::ContainsSubstring("no rotation"));
  CHECK_THAT(refusal([](CameraInfo&, CameraInfo& right) { right.R[0] = std::nan(""); }),
             Catch::Matchers::ContainsSubstring("no rotation"));
  CHECK_THAT(refusal([](CameraInfo&, CameraInfo& right) { right.width = 3; }),
             Catch::Matchers::ContainsSubstring("of no camera"));
}

TEST_CASE("stereo without a configured right camera waits for CameraInfo and uses it") {
  const auto rig = require_ok(vehicle::Rig::make_unrectified(width, height));
  Noise noise;
  noise.config.camera.camera = rig.camera;
  noise.config.depth = StereoDepthConfig{.right_image = "/r", .right_camera = {}, .right_info = "/i"};
  FramePair pair{
      .image = {{}, width, height, std::vector<std::uint8_t>(width * height)}, .right_image = {}, .scan = {}};
  pair.right_image = pair.image;
  DepthSource source(noise.config, [] { return true; });
  CHECK_FALSE(source.has_cameras());
  CHECK(source.prepare());
  CHECK(source.estimate(pair).error().code == "camera_info_missing");
  source.set_right_camera_info(info(rig, true));
  CHECK_FALSE(source.has_cameras());
  source.set_left_camera_info(info(rig, false));
  CHECK(source.has_cameras());
  CHECK(require_ok(source.estimate(pair)).width == width);
}

TEST_CASE("a long estimate is polled and cancelled after its timeout; the next one may succeed") {
  Noise noise;
  int breaths = 0;
  noise.config.depth_timeout = 1ms;
  DepthSource impatient(noise.config, [&] { return ++breaths > 0; });
  const auto late = impatient.estimate(noise.pair);
  REQUIRE_FALSE(late);
  CHECK(late.error().code == "depth_failed");
  CHECK_THAT(late.error().context, Catch::Matchers::Contains("took longer than 0.001 s"));
  CHECK(breaths > 0);
  CHECK_FALSE(impatient.busy());
  noise.config.depth_timeout = 60s;  // the source sees its pair's configuration
  CHECK(require_ok(impatient.estimate(noise.pair)).width == 1600);
}

TEST_CASE("an estimate is cancelled when calibd stops") {
  Noise noise;
  DepthSource source(noise.config, [] { return false; });
  const auto ended = source.estimate(noise.pair);
  REQUIRE_FALSE(ended);
  CHECK_THAT(ended.error().context, Catch::Matchers::Contains("calibd ends"));
}

TEST_CASE("a second estimate during the first one is refused") {
  Noise noise;
  std::string meanwhile;
  DepthSource* asked = nullptr;
  DepthSource source(noise.config, [&] {
    const auto refused = asked->estimate(noise.pair);
    meanwhile = refused ? "" : refused.error().context;
    return true;
  });
  asked = &source;
  CHECK(source.estimate(noise.pair));
  CHECK_THAT(meanwhile, Catch::Matchers::Contains("already"));
}

TEST_CASE("a source that cannot be made fails each time with the cause") {
  Noise noise;
  noise.config.depth = OnnxDepthConfig{.model = "/nowhere/model.yaml", .settings = {}};
  DepthSource source(noise.config, [] { return true; });
  for (int i = 0; i < 2; ++i) {
    const auto refused = source.prepare();
    REQUIRE_FALSE(refused);
    CHECK(refused.error().code == "depth_failed");
    CHECK_THAT(refused.error().context, Catch::Matchers::Contains("/nowhere/model.yaml"));
  }
  CHECK(source.estimate(noise.pair).error().code == "depth_failed");
}
