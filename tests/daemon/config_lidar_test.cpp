#include "config.hpp"
#include "support/catch.hpp"
#include "support/support.hpp"

using namespace calib;
using namespace calib::test;

namespace {

/// A configuration whose fifth line is `lidar: {mapping}`.
Result<Config> parse(const std::string& mapping) {
  return parse_config(
      "vehicle: car\npairs:\n  - name: front\n    camera: {image: /l, size: [640, 480], intrinsics: [500, 500, 320, "
      "240], model: rectified}\n    lidar: {" +
          mapping +
          "}\n    T_camera_lidar: {translation_m: [0, 0, 0], quaternion_xyzw: [0, 0, 0, 1]}\n"
          "    depth: {source: topic, image: /d}\n",
      "c.yaml", {"/state", "/runtime", "/credentials"});
}

}  // namespace

TEST_CASE("a cloud may have a million points by default") {
  const auto of = [](const std::string& number) { return parse("cloud: /p, max_points: " + number); };
  CHECK(require_ok(parse("cloud: /p")).pairs[0].lidar.max_points == 1'000'000);
  CHECK(require_ok(of("1000")).pairs[0].lidar.max_points == 1000);
  CHECK(require_ok(of("4000000")).pairs[0].lidar.max_points == 4'000'000);
  for (const std::string number : {"999", "4000001", "-1", "many"})
    CHECK(of(number).error().context.starts_with("c.yaml:5: pairs[0].lidar.max_points: "));
}
