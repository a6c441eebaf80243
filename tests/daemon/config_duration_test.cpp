#include "config.hpp"

#include <charconv>

#include "support/catch.hpp"
#include "support/support.hpp"

using namespace calib;
using namespace std::chrono_literals;
using Catch::Matchers::ContainsSubstring;

namespace {

Result<Config> parse(const std::string& sampling) {
  const std::string yaml = "vehicle: car\nsampling: {" + sampling + R"(}
pairs:
  - name: front
    camera: {image: /l, model: rectified, size: [640, 480], intrinsics: [500, 500, 320, 240]}
    lidar: {cloud: /p}
    T_camera_lidar: {translation_m: [0, 0, 0], quaternion_xyzw: [0, 0, 0, 1]}
    depth: {source: stereo, right_image: /r, baseline_m: 0.3}
)";
  return parse_config(yaml, "c.yaml", {"/state", "/runtime", "/credentials"});
}

/// 1900 ms as 1.9.
std::string in_seconds(int ms) {
  char text[32];
  return {text, std::to_chars(text, text + sizeof text, ms / 1000.0).ptr};
}

}  // namespace

TEST_CASE("a window may be as long as the period, in whichever units both are written") {
  for (int ms = 100; ms <= 2000; ++ms) {
    const std::string in_ms = std::to_string(ms) + "ms", in_s = in_seconds(ms) + "s";
    for (const auto& [period, window] : {std::pair(in_ms, in_ms), {in_s, in_s}, {in_s, in_ms}, {in_ms, in_s}}) {
      INFO(period << ", " << window);
      const Config config = test::require_ok(parse("period: " + period + ", window: " + window));
      REQUIRE(config.sampling.period == std::chrono::milliseconds(ms));
      REQUIRE(config.sampling.window == config.sampling.period);
    }
    const auto longer = parse("period: " + in_ms + ", window: " + std::to_string(ms) + ".001ms");
    REQUIRE_FALSE(longer);
    CHECK_THAT(longer.error().context, ContainsSubstring("c.yaml:2: sampling.window: "));
  }
}

TEST_CASE("durations are accepted at their bounds and refused beyond them") {
  for (const char* period : {"100ms", "0.1s", "24h", "1440min", "86400s", "86400000ms", "1e2ms", "8.64e4s"})
    CHECK(parse(std::string("period: ") + period + ", window: 100ms"));
  for (const char* period : {"99.999ms", "0.099999999s", "24.0000001h", "86400.000001s", "-24h", "1e300h", "-1e300h",
                             "1e18s", "9223372036.9s", "0s"}) {
    const auto refused = parse(std::string("period: ") + period);
    REQUIRE_FALSE(refused);
    CHECK_THAT(refused.error().context,
               ContainsSubstring("c.yaml:2: sampling.period: " + std::string(period) + " is outside 0.1s .. 86400s"));
  }
  CHECK(test::require_ok(parse("max_time_difference: 0ms")).sampling.max_time_difference == 0ns);
  CHECK(test::require_ok(parse("max_time_difference: 1s")).sampling.max_time_difference == 1s);
  CHECK(test::require_ok(parse("max_time_difference: 0.1ms")).sampling.max_time_difference == 100us);
  CHECK_FALSE(parse("max_time_difference: 1.000000001s"));
  CHECK_FALSE(parse("max_time_difference: -0.001ms"));
}
