#include "depth/depth_config.hpp"

#include <fstream>

#include "calib/sha256.hpp"
#include "config.hpp"
#include "support/catch.hpp"
#include "support/support.hpp"

using namespace calib;
using namespace calib::test;

namespace {

Camera camera() { return require_ok(Camera::make(CameraModel::rectified, 640, 480, {500, 500, 320, 240})); }

}  // namespace

TEST_CASE("each kind of depth source is described by the table") {
  const DepthSourceKind &stereo = depth_kind(StereoDepthConfig{}), &onnx = depth_kind(OnnxDepthConfig{}),
                        &topic = depth_kind(TopicDepthConfig{});
  CHECK((stereo.name == "stereo" && stereo.is_metric && !stereo.is_monocular && stereo.colour == Colour::none));
  CHECK((onnx.name == "onnx" && !onnx.is_metric && onnx.is_monocular && onnx.colour == Colour::rgb));
  CHECK((topic.name == "topic" && topic.is_metric && !topic.is_monocular && topic.colour == Colour::none));
  CHECK((onnx.preparation_failure && !stereo.preparation_failure && !topic.preparation_failure));
}

TEST_CASE("a source adds the topics that it reads, and no others") {
  const auto topics_of = [](const DepthConfig& source) {
    PairTopics topics;
    add_topics(source, camera(), topics);
    return topics;
  };
  const PairTopics stereo = topics_of(StereoDepthConfig{.right_image = "/r", .right_camera = {}, .right_info = "/i"});
  CHECK((stereo.right_image == "/r" && stereo.right_camera_info == "/i" && !stereo.depth));
  const PairTopics onnx = topics_of(OnnxDepthConfig{.model = "/m.yaml", .settings = {}});
  CHECK((!onnx.right_image && !onnx.right_camera_info && !onnx.depth && onnx.colour == Colour::rgb));
  const PairTopics topic = topics_of(TopicDepthConfig{.topic = {"/d", DepthMessage::disparity}, .camera = {}});
  CHECK((!topic.right_image && topic.depth->name == "/d" && topic.depth->message == DepthMessage::disparity));
}

TEST_CASE("a network's descriptor is pinned, and another one is refused") {
  const TemporaryFolder folder;
  const auto descriptor = folder.path() / "model.yaml";
  std::ofstream(descriptor) << "file: a.onnx\n";
  DepthConfig source = OnnxDepthConfig{.model = descriptor, .settings = {}};
  CHECK(pinned_text(source) == "model:\n");
  CHECK(pin_files(source).has_value());
  CHECK(pinned_text(source) == "model:" + sha256_hex("file: a.onnx\n") + "\n");
  std::ofstream(descriptor) << "file: b.onnx\n";
  const auto refused = make_estimator(source, camera(), {});
  REQUIRE_FALSE(refused);
  CHECK(refused.error().code == "depth_failed");
  CHECK_THAT(refused.error().context, Catch::Matchers::Contains("has changed since calibd started"));
}

TEST_CASE("sources that read no files pin nothing") {
  for (DepthConfig source : {DepthConfig(StereoDepthConfig{}), DepthConfig(TopicDepthConfig{})}) {
    CHECK(pin_files(source).has_value());
    CHECK(pinned_text(source).empty());
  }
}

TEST_CASE("stereo needs CameraInfo only where the configuration does not give the right camera") {
  StereoDepthConfig stereo{.right_image = "/r", .right_camera = {}, .right_info = "/i"};
  const CameraInfo info{};
  CHECK_FALSE(has_cameras(stereo, camera(), {}));
  CHECK(has_cameras(stereo, camera(), {{}, info}));
  const auto lens = require_ok(Camera::make(CameraModel::plumb_bob, 640, 480, {500, 500, 320, 240}, {-0.3, 0.1, 0, 0}));
  CHECK_FALSE(has_cameras(stereo, lens, {{}, info}));
  CHECK(has_cameras(stereo, lens, {info, info}));
  stereo.right_info.reset();
  CHECK(has_cameras(stereo, camera(), {}));
  CHECK(has_cameras(OnnxDepthConfig{}, camera(), {}));
  CHECK(has_cameras(TopicDepthConfig{}, camera(), {}));
}
