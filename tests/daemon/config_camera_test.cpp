#include "config.hpp"
#include "pair_topics.hpp"
#include "support/catch.hpp"
#include "support/support.hpp"

using namespace calib;
using namespace calib::test;

namespace {

/// A configuration whose fourth line is `camera: {image: /l, mapping}`.
Result<Config> parse(const std::string& mapping) {
  return parse_config(
      "vehicle: car\npairs:\n  - name: front\n    camera: {image: /l, size: [640, 480], intrinsics: [500, 500, 320, "
      "240], model: rectified" +
          mapping +
          "}\n    lidar: {cloud: /p}\n"
          "    T_camera_lidar: {translation_m: [0, 0, 0], quaternion_xyzw: [0, 0, 0, 1]}\n"
          "    depth: {source: topic, image: /d}\n",
      "c.yaml", {"/state", "/runtime", "/credentials"});
}

}  // namespace

TEST_CASE("how binning and roi of CameraInfo are read goes with its topic") {
  const auto of = [](const std::string& word) { return parse(", info: /i, info_reduction: " + word); };
  const auto topic_of = [](const Config& config) { return *topics_of(config.pairs[0]).camera_info; };
  CHECK(topic_of(require_ok(parse(", info: /i"))).reduction == InfoReduction::as_specified);
  CHECK(topic_of(require_ok(of("as_specified"))).reduction == InfoReduction::as_specified);
  CHECK(topic_of(require_ok(of("ignored"))).reduction == InfoReduction::ignored);
  CHECK(topic_of(require_ok(of("size_only"))).reduction == InfoReduction::size_only);
  CHECK(topic_of(require_ok(of("size_only"))).name == "/i");
  CHECK(of("none").error().context ==
        "c.yaml:4: pairs[0].camera.info_reduction: is none of: as_specified, ignored, size_only");
  CHECK_THAT(parse(", info_reduction: ignored").error().context,
             Catch::Matchers::EndsWith("is about info, which is not given"));
}
