#include "config_reload.hpp"

#include "calib/sha256.hpp"
#include "support/catch.hpp"
#include "support/support.hpp"

using namespace calib;
using namespace std::chrono_literals;
using Keys = std::vector<std::string>;

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
    drift: {baseline_pairs: 20, min_scene_change: 0.3}
    recalibration: {mode: propose, max_rotation_deg: 5}
)";

Config parsed(const std::string& text) {
  return test::require_ok(parse_config(text, "c.yaml", {"/state", "/runtime", "/credentials"}));
}

std::string with(std::string text, const std::string& what, const std::string& instead) {
  const auto at = text.find(what);
  REQUIRE(at != std::string::npos);
  return text.replace(at, what.size(), instead);
}

}  // namespace

TEST_CASE("thresholds, modes and intervals are taken over, and nothing that evidence depends on") {
  struct Change {
    const char *what, *instead, *key;
    bool taken_over;
  };
  for (const auto& [what, instead, key, taken_over] : {
           Change{"period: 10s", "period: 5s", "sampling.period", true},
           Change{"window: 2s", "window: 1s", "sampling.window", true},
           Change{"baseline_pairs: 20", "baseline_pairs: 30", "pairs[0].drift.baseline_pairs", true},
           Change{"{baseline_pairs: 20,", "{must_notice_deg: 1, baseline_pairs: 20,", "pairs[0].drift.must_notice_deg",
                  true},
           Change{"mode: propose", "mode: apply", "pairs[0].recalibration.mode", true},
           Change{"mode: propose,", "", "pairs[0].recalibration.mode", true},
           Change{"mode: propose", "mode: propose, frames: 40", "pairs[0].recalibration.frames", true},
           Change{"domain: 3", "domain: 4", "dds.domain", false},
           Change{"20ms", "30ms", "sampling.max_time_difference", false},
           Change{"vehicle: car", "vehicle: van", "vehicle", false},
           Change{"min_scene_change: 0.3", "min_scene_change: 0.2", "pairs[0].drift.min_scene_change", false},
           Change{"max_rotation_deg: 5", "max_rotation_deg: 6", "pairs[0].recalibration.max_rotation_deg", false},
           Change{"image: /l", "image: /left", "pairs[0].camera.image", false},
           Change{"[500, 500", "[501, 500", "pairs[0].camera.intrinsics", false},
           Change{"translation_m: [0, 0, 0]", "translation_m: [1, 0, 0]", "pairs[0].T_camera_lidar.translation_m",
                  false},
           Change{"name: front", "name: rear", "pairs", false},
           Change{"vehicle: car", "vehicle: car\nstate_dir: /elsewhere", "state_dir", false},
       }) {
    INFO(what << " becomes " << instead);
    Config running = parsed(yaml);
    const std::string before = running.sha256;
    const Config wanted = parsed(with(yaml, what, instead));
    const auto changes = take_over(wanted, running);
    CHECK(changes.taken_over == (taken_over ? Keys{key} : Keys{}));
    CHECK(changes.need_restart == (taken_over ? Keys{} : Keys{key}));
    CHECK(running.sha256 == (taken_over ? wanted.sha256 : before));
    // Evidence is measured as before, whatever was taken over.
    CHECK(running.pairs[0].evidence_text == parsed(yaml).pairs[0].evidence_text);
    // A second time nothing is left to be taken over.
    CHECK(take_over(wanted, running).taken_over.empty());
  }
}

TEST_CASE("values are in force when they are taken over, and those beside them stay") {
  Config running = parsed(yaml);
  const std::string changed =
      with(with(with(yaml, "period: 10s", "period: 7s"), "max_rotation_deg: 5", "max_rotation_deg: 9"), "mode: propose",
           "mode: apply");
  const Config wanted = parsed(changed);
  const std::string before = running.sha256;
  const auto changes = take_over(wanted, running);
  CHECK(changes.taken_over == Keys{"pairs[0].recalibration.mode", "sampling.period"});
  CHECK(changes.need_restart == Keys{"pairs[0].recalibration.max_rotation_deg"});
  CHECK(running.sampling.period == 7s);
  CHECK(running.pairs[0].recalibration.mode == RecalibrationMode::apply);
  CHECK(running.pairs[0].recalibration.max_rotation_rad == Approx(5 * radians_per_degree));
  // Records name what they were computed under: here neither file, but both.
  CHECK(running.sha256 == sha256_hex(before + '\n' + wanted.sha256 + '\n'));
  // Back to the first file.
  const auto back = take_over(parsed(yaml), running);
  CHECK(back.taken_over == changes.taken_over);
  CHECK(back.need_restart.empty());
  CHECK(running.sha256 == before);
}

TEST_CASE("comments and layout are no change") {
  Config running = parsed(yaml);
  const Config wanted = parsed("# new\n" + with(yaml, "{period: 10s, window: 2s,", "{window: 2s, 'period':   10s,"));
  const auto changes = take_over(wanted, running);
  CHECK(changes.taken_over.empty());
  CHECK(changes.need_restart.empty());
  CHECK(running.sha256 == wanted.sha256);
}
