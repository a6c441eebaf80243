#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <fstream>
#include <iterator>

#include "config.hpp"
#include "support/catch.hpp"
#include "support/support.hpp"

using namespace calib;
using namespace calib::test;
using namespace std::chrono_literals;

namespace {

/// A configuration whose last line, the seventh, is `depth: {mapping}`.
std::string depth(const std::string& mapping, const std::string& lens = "model: rectified") {
  return "vehicle: car\npairs:\n  - name: front\n    camera: {image: /l, size: [640, 480], intrinsics: [500, 500, 320, "
         "240], " +
         lens +
         "}\n    lidar: {cloud: /p}\n    T_camera_lidar: {translation_m: [0, 0, 0], quaternion_xyzw: [0, 0, 0, 1]}\n"
         "    depth: {" +
         mapping + "}\n";
}

Result<Config> parse(const std::string& yaml) {
  return parse_config(yaml, "c.yaml", {"/state", "/runtime", "/credentials"});
}

PairConfig source(const std::string& mapping, const std::string& lens = "model: rectified") {
  return require_ok(parse(depth(mapping, lens))).pairs[0];
}

std::string refusal(const std::string& yaml) {
  const auto config = parse(yaml);
  return config ? "taken" : config.error().context;
}

const std::string right_lens =
    "right_camera: {model: equidistant, size: [320, 240], intrinsics: [200, 200, 160, 120], distortion: [0, 0, 0, 0]";
const std::string turned = "{translation_m: [-0.5, 0, 0], quaternion_xyzw: [0, 0.1, 0, 0.99498743710662]}";

}  // namespace

TEST_CASE("stereo of rectified images needs a baseline or the right camera's CameraInfo") {
  const PairConfig pair = source("source: stereo, right_image: /r, baseline_m: 0.3");
  const auto& stereo = std::get<StereoDepthConfig>(pair.depth);
  CHECK(stereo.right_image == "/r");
  CHECK(stereo.matcher == StereoMatcher::sgbm);
  CHECK(stereo.right_camera->camera.fx() == 500);
  CHECK(translation_m(stereo.right_camera->T_right_left) == std::array{-0.3, 0.0, 0.0});
  CHECK((pair.depth_range.min_m == 0.5 && pair.depth_range.max_m == 200));
  CHECK(pair.depth_timeout == 30s);
  CHECK(std::get<StereoDepthConfig>(source("source: stereo, right_image: /r, right_info: /i").depth).right_info ==
        "/i");
}

TEST_CASE("stereo with raw images needs the right camera") {
  const std::string lens = "model: plumb_bob, distortion: [-0.3, 0.1, 0, 0], info: /info";
  const std::string by_hand = "source: stereo, right_image: /r, " + right_lens + ", T_right_left: " + turned + "}";
  const auto stereo = std::get<StereoDepthConfig>(source(by_hand, lens).depth);
  CHECK(stereo.right_camera->camera.model() == CameraModel::equidistant);
  CHECK(stereo.right_camera->camera.width() == 320);
  CHECK(rotation_angle_rad(stereo.right_camera->T_right_left) == Approx(2 * std::asin(0.1)));
  CHECK_FALSE(stereo.right_info);
  const std::string by_info = "source: stereo, right_image: /r, right_info: /i";
  CHECK_FALSE(std::get<StereoDepthConfig>(source(by_info, lens).depth).right_camera);
  const std::string no_info = "model: plumb_bob, distortion: [-0.3, 0.1, 0, 0]";
  CHECK_THAT(refusal(depth(by_info, no_info)), Catch::Matchers::EndsWith("needs camera.info too: both cameras say how "
                                                                         "they are to be rectified"));
  CHECK_THAT(refusal(depth(by_hand + ", right_info: /i", lens)), Catch::Matchers::ContainsSubstring("needs one of"));
  CHECK_THAT(refusal(depth("source: stereo, right_image: /r, " + right_lens + "}", lens)),
             Catch::Matchers::ContainsSubstring("right_camera.T_right_left: missing"));
}

TEST_CASE("a network needs its descriptor, and by default takes one thread and little memory") {
  const PairConfig pair = source("source: onnx, model: /m.yaml");
  const auto& onnx = std::get<OnnxDepthConfig>(pair.depth);
  CHECK(onnx.model == "/m.yaml");
  CHECK((onnx.settings.threads == 1 && !onnx.settings.spinning && !onnx.settings.memory_arena));
  CHECK((onnx.settings.keep_session && onnx.settings.execution_provider == "cpu"));
  CHECK((pair.depth_range.min_m == 0 && std::isinf(pair.depth_range.max_m)));
  const auto other = source(
      "source: onnx, model: /m.yaml, threads: 2, spinning: true, memory_arena: true, "
      "keep_session: false, execution_provider: CUDA, timeout: 500ms");
  const OnnxSettings& settings = std::get<OnnxDepthConfig>(other.depth).settings;
  CHECK((settings.threads == 2 && settings.spinning && settings.memory_arena && !settings.keep_session));
  CHECK(settings.execution_provider == "CUDA");
  CHECK(other.depth_timeout == 500ms);
}

TEST_CASE("depth from a topic is an image or a disparity image, of the camera or of a depth camera") {
  const auto image = std::get<TopicDepthConfig>(source("source: topic, image: /d, range_m: [0.2, 8]").depth);
  CHECK((image.topic.name == "/d" && image.topic.message == DepthMessage::image && !image.camera));
  CHECK(std::get<TopicDepthConfig>(source("source: topic, disparity: /d").depth).topic.message ==
        DepthMessage::disparity);
  const auto own = std::get<TopicDepthConfig>(
      source("source: topic, image: /d, camera: {model: rectified, size: [160, 120], intrinsics: [100, 100, 80, 60]}, "
             "T_camera_depth: " +
             turned)
          .depth);
  CHECK(own.camera->camera.width() == 160);
  CHECK(own.camera->T_camera_depth.translation().x() == -0.5);
}

TEST_CASE("keys and values that do not belong to a depth source are refused") {
  const std::pair<const char*, const char*> refusals[] = {
      {"source: onnx", "pairs[0].depth.model: missing; add it"},
      {"source: onnx, model: m.yaml", "pairs[0].depth.model: needs an absolute path"},
      {"source: onnx, model: /m, range_m: [1, 2]", "pairs[0].depth.range_m: is for stereo and topic"},
      {"source: onnx, model: /m, right_image: /r", "pairs[0].depth.right_image: unknown key"},
      {"source: onnx, model: /m, threads: 0", "pairs[0].depth.threads: 0 is outside 1 .. 64"},
      {"source: onnx, model: /m, spinning: 1", "pairs[0].depth.spinning: needs true or false"},
      {"source: onnx, model: /m, spinning: 'true'", "pairs[0].depth.spinning: needs true or false"},
      {"source: onnx, model: /m, execution_provider: 'c u'", "pairs[0].depth.execution_provider: needs"},
      {"source: topic", "pairs[0].depth: needs one of image (sensor_msgs/Image) and disparity"},
      {"source: topic, image: /d, disparity: /e", "pairs[0].depth: needs one of"},
      {"source: topic, image: /d/compressedDepth", "pairs[0].depth.image: is a compressed topic"},
      {"source: topic, image: /d, T_camera_depth: {}", "pairs[0].depth.T_camera_depth: camera and T_camera_depth"},
      {"source: topic, image: /d, camera: {}", "pairs[0].depth.camera: camera and T_camera_depth belong"},
      {"source: topic, image: /d, model: /m", "pairs[0].depth.model: unknown key"},
      {"source: stereo, right_image: /r", "pairs[0].depth: needs one of baseline_m (rectified images), "},
  };
  for (const auto& [mapping, words] : refusals) {
    INFO(mapping);
    CHECK_THAT(refusal(depth(mapping)), Catch::Matchers::StartsWith("c.yaml:7: " + std::string(words)));
  }
}

TEST_CASE("the depth sources that the example in systemd/ comments out are valid") {
  std::ifstream in(std::filesystem::path(std::getenv("CALIBD_SOURCE_DIR")) / "systemd" / "calibd.yaml");
  const std::string example{std::istreambuf_iterator<char>(in), {}};
  const std::string indent = "      ", comment = indent + "# ";
  const auto begin = example.find(indent + "source: stereo"), end = example.find("    drift:");
  REQUIRE((begin != std::string::npos && end != std::string::npos));
  for (const std::string name : {"onnx", "topic"}) {
    std::string source = example.substr(example.find(comment + "source: " + name));
    source.resize(std::min(source.find("      #\n"), source.find("    drift:")));
    for (auto at = source.find("# "); at != std::string::npos; at = source.find("\n" + comment))
      source.erase(source.find("# ", at), 2);
    INFO(source);
    const Config config = require_ok(parse(example.substr(0, begin) + source + example.substr(end)));
    CHECK(std::holds_alternative<OnnxDepthConfig>(config.pairs[0].depth) == (name == "onnx"));
  }
}

TEST_CASE("the rate of false alerts is shared among the samples of a week and among the pairs") {
  Config config = require_ok(parse(depth("source: stereo, right_image: /r, baseline_m: 0.5")));
  const DriftConfig drift{.false_alerts_per_1000_vehicle_weeks = 2, .driving_hours_per_week = 10};
  CHECK(false_alarms_per_pair(config, drift) == Approx(2 / (1000 * 10 * 360.0)));
  config.sampling.period = 5s;
  CHECK(false_alarms_per_pair(config, drift) == Approx(2 / (1000 * 10 * 720.0)));
  config.pairs.resize(4, config.pairs[0]);
  CHECK(false_alarms_per_pair(config, drift) == Approx(2 / (1000 * 10 * 720.0) / 4));
}
