// What of the configuration evidence depends on, how long it counts, and where the chain's head is remembered.
#include "config.hpp"
#include "support/catch.hpp"
#include "support/support.hpp"

using namespace calib;
using namespace std::chrono_literals;

namespace {

const std::string yaml = R"(vehicle: car
dds: {domain: 3}
sampling: {period: 10s, window: 2s, max_time_difference: 20ms}
pairs:
  - name: front
    camera: {image: /l, model: rectified, size: [640, 480], intrinsics: [500, 500, 320, 240]}
    lidar: {cloud: /p}
    T_camera_lidar: {translation_m: [0, 0, 0], quaternion_xyzw: [0, 0, 0, 1]}
    depth: {source: stereo, right_image: /r, baseline_m: 0.3}
    motion: {topic: /imu, type: imu}
    drift: {baseline_pairs: 20}
    recalibration: {mode: propose, max_rotation_deg: 5}
)";

Config parsed(const std::string& text, const DefaultFolders& places = {"/state", "/runtime", "/credentials"}) {
  return test::require_ok(parse_config(text, "c.yaml", places));
}

/// The text that evidence depends on when `what` is replaced.
std::string evidence_with(const std::string& what, const std::string& instead) {
  std::string text = yaml;
  const auto at = text.find(what);
  REQUIRE(at != std::string::npos);
  return parsed(text.replace(at, what.size(), instead)).pairs[0].evidence_text;
}

}  // namespace

TEST_CASE("evidence depends on the settings that it is measured with, not on layout or other settings") {
  const std::string now = parsed(yaml).pairs[0].evidence_text;
  for (const auto& [what, instead] :
       std::initializer_list<std::pair<const char*, const char*>>{{"vehicle: car", "vehicle: van"},
                                                                  {"domain: 3", "domain: 4"},
                                                                  {"20ms", "30ms"},
                                                                  {"image: /l", "image: /left"},
                                                                  {"[500, 500", "[501, 500"},
                                                                  {"cloud: /p", "cloud: /points"},
                                                                  {"right_image: /r", "right_image: /right"},
                                                                  {"baseline_m: 0.3", "baseline_m: 0.31"},
                                                                  {"type: imu", "type: imu, max_turn_deg: 2"},
                                                                  {"max_rotation_deg: 5", "max_rotation_deg: 6"}}) {
    INFO(what << " becomes " << instead);
    CHECK(evidence_with(what, instead) != now);
  }
  for (const auto& [what, instead] : std::initializer_list<std::pair<const char*, const char*>>{
           {"vehicle: car", "# a comment\nvehicle: 'car'"},
           {"{image: /l, model: rectified,", "{model: rectified,   image: /l,"},
           {"name: front", "name: rear"},
           {"translation_m: [0, 0, 0]", "translation_m: [1, 0, 0]"},
           {"baseline_pairs: 20", "baseline_pairs: 30"},
           {"mode: propose", "mode: apply"},
           {"period: 10s", "period: 5s"}}) {
    INFO(what << " becomes " << instead);
    CHECK(evidence_with(what, instead) == now);
  }
}

TEST_CASE("evidence expires after two periods and a window, or after two cycles if these take longer") {
  const SamplingConfig sampling{.period = 10s, .window = 2s};
  CHECK(evidence_lifetime(sampling, 0s) == 22s);
  CHECK(evidence_lifetime(sampling, 9s) == 22s);
  CHECK(evidence_lifetime(sampling, 15s) == 32s);
  CHECK(evidence_lifetime({.period = 100ms, .window = 50ms}, 0s) == 5s);
}

TEST_CASE("the default of head_dir is a folder beside state_dir") {
  CHECK(parsed(yaml).head_dir == "/state-head");
  CHECK(parsed(yaml, {"/var/lib/calibd/", "/runtime", "/credentials"}).head_dir == "/var/lib/calibd-head");
  CHECK(parsed(yaml, {"/state", "/runtime", "/credentials", "/given"}).head_dir == "/given");
  CHECK(parsed("head_dir: /mine\n" + yaml).head_dir == "/mine");
  const auto same = parse_config("head_dir: /state/.\n" + yaml, "c.yaml", {"/state", "/runtime", "/credentials"});
  REQUIRE_FALSE(same);
  CHECK_THAT(same.error().context, Catch::Matchers::ContainsSubstring("needs another folder than state_dir"));
}
