#include "config.hpp"

#include <cstdlib>
#include <fstream>
#include <iterator>

#include "calib/record.hpp"
#include "support/catch.hpp"
#include "support/support.hpp"

using namespace calib;
using namespace calib::test;
using namespace std::chrono_literals;

namespace {

// Every key, each on a line of its own, so that a refusal can be checked to name the right one.
const std::string full = R"(vehicle: demo-car
state_dir: /var/lib/calibd
runtime_dir: /run/calibd
dds:
  domain: 3
  interface: lo
signing_key: /etc/calibd/signing.key
sampling:
  period: 2min
  window: 1.5s
  max_time_difference: 20ms
pairs:
  - name: front
    camera:
      image: /left/image
      info: /left/camera_info
      frame_id: camera_left/optical
      model: rectified
      size: [1242, 375]
      intrinsics: [721.5, 722, 609.5, 172.8]
      distortion: []
    lidar:
      cloud: /lidar/points
      frame_id: lidar_top
    T_camera_lidar:
      translation_m: [0.1, -0.2, 0.3]
      quaternion_xyzw: [0.5, -0.5, 0.5, 0.5]
    depth:
      source: stereo
      right_image: /right/image
      baseline_m: 0.5327
      matcher: bm
      range_m: [1, 80]
      timeout: 5s
    drift:
      baseline_pairs: 30
      false_alerts_per_1000_vehicle_weeks: 2.5
      driving_hours_per_week: 40
      must_notice_deg: 1
      notice_within: 45min
      min_scene_change: 0.4
    recalibration:
      mode: apply
      frames: 40
      max_rotation_deg: 3
      max_translation_cm: 20
      min_interval: 5min
)";

const std::string least = R"(vehicle: car
pairs:
  - name: front
    camera: {image: /l, model: rectified, size: [640, 480], intrinsics: [500, 500, 320, 240]}
    lidar: {cloud: /p}
    T_camera_lidar: {translation_m: [0, 0, 0], quaternion_xyzw: [0, 0, 0, 1]}
    depth: {source: stereo, right_image: /r, baseline_m: 0.3}
)";

const DefaultFolders places{"/state", "/runtime", "/credentials"};

Result<Config> parse(const std::string& yaml) { return parse_config(yaml, "c.yaml", places); }

/// `full` with `what` (which must be there) replaced.
std::string with(const std::string& what, const std::string& instead) {
  std::string yaml = full;
  const auto at = yaml.find(what);
  REQUIRE(at != std::string::npos);
  return yaml.replace(at, what.size(), instead);
}

std::string refusal(const std::string& yaml) {
  const auto config = parse(yaml);
  if (config) return "taken";
  CHECK(config.error().code == "bad_config");
  CHECK(config.error().context.find('\n') == std::string::npos);
  return config.error().context;
}

}  // namespace

TEST_CASE("every key is read, into SI units") {
  const Config config = require_ok(parse(full));
  CHECK(config.vehicle == "demo-car");
  CHECK(config.state_dir == "/var/lib/calibd");
  CHECK(config.runtime_dir == "/run/calibd");
  CHECK(config.dds.domain == 3);
  CHECK(config.dds.interface == "lo");
  CHECK(config.signing_key == "/etc/calibd/signing.key");
  CHECK(config.sampling.period == 2min);
  CHECK(config.sampling.window == 1500ms);
  CHECK(config.sampling.max_time_difference == 20ms);
  CHECK(config.sha256 == sha256_hex(full));
  REQUIRE(config.pairs.size() == 1);
  const PairConfig& pair = config.pairs[0];
  CHECK(pair.name == "front");
  CHECK(pair.camera.image == "/left/image");
  CHECK(pair.camera.info->name == "/left/camera_info");
  CHECK(pair.camera.frame_id.name == "camera_left/optical");
  CHECK(pair.camera.camera.model() == CameraModel::rectified);
  CHECK(pair.camera.camera.width() == 1242);
  CHECK(pair.camera.camera.height() == 375);
  CHECK(pair.camera.camera.fy() == 722);
  CHECK(pair.camera.camera.cy() == 172.8);
  CHECK(pair.camera.camera.distortion().empty());
  CHECK(pair.lidar.cloud == "/lidar/points");
  CHECK(pair.lidar.frame_id.name == "lidar_top");
  CHECK(translation_m(pair.T_camera_lidar) == std::array{0.1, -0.2, 0.3});
  CHECK((pair.T_camera_lidar.linear() * Eigen::Vector3d::UnitX() - Eigen::Vector3d::UnitZ()).norm() < 1e-12);
  const auto& stereo = std::get<StereoDepthConfig>(pair.depth);
  CHECK(stereo.right_image == "/right/image");
  CHECK(stereo.right_camera->T_right_left.translation().x() == -0.5327);
  CHECK(stereo.matcher == StereoMatcher::bm);
  CHECK((pair.depth_range.min_m == 1 && pair.depth_range.max_m == 80));
  CHECK(pair.depth_timeout == 5s);
  CHECK(pair.drift.baseline_pairs == 30);
  CHECK(pair.drift.false_alerts_per_1000_vehicle_weeks == 2.5);
  CHECK(pair.drift.driving_hours_per_week == 40);
  CHECK(pair.drift.must_detect_rad == Approx(radians_per_degree));
  CHECK(pair.drift.notice_within == 45min);
  CHECK(pair.drift.min_scene_change == 0.4);
  CHECK(pair.recalibration.mode == RecalibrationMode::apply);
  CHECK(pair.recalibration.frames == 40);
  CHECK(pair.recalibration.max_rotation_rad == Approx(3 * radians_per_degree));
  CHECK(pair.recalibration.max_translation_m == Approx(0.2));
  CHECK(pair.recalibration.min_interval == 5min);
}

TEST_CASE("keys that are missing have the documented default") {
  const Config config = require_ok(parse(least));
  CHECK(config.state_dir == "/state");
  CHECK(config.runtime_dir == "/runtime");
  CHECK(config.signing_key == "/credentials/signing.key");
  CHECK(config.dds.domain == 0);
  CHECK(config.dds.interface == "auto");
  CHECK(config.sampling.period == 10s);
  CHECK(config.sampling.window == 2s);
  CHECK(config.sampling.max_time_difference == 50ms);
  const PairConfig& pair = config.pairs[0];
  CHECK_FALSE(pair.camera.info);
  CHECK(pair.camera.frame_id.name == "camera_optical");
  CHECK(pair.lidar.frame_id.name == "lidar");
  CHECK((!pair.drift.baseline_pairs && !pair.drift.min_scene_change && pair.drift.notice_within == 2h));
  CHECK(pair.drift.false_alerts_per_1000_vehicle_weeks == 1);
  CHECK(pair.drift.driving_hours_per_week == 56);
  CHECK(pair.drift.must_detect_rad == Approx(0.5 * radians_per_degree));
  CHECK(pair.recalibration.mode == RecalibrationMode::propose);
  CHECK(pair.recalibration.frames == 25);
  CHECK(pair.recalibration.max_rotation_rad == Approx(5 * radians_per_degree));
  CHECK(pair.recalibration.max_translation_m == Approx(0.5));
  CHECK(pair.recalibration.min_interval == 10min);
}

TEST_CASE("a duration may be quoted, as JSON does") {
  CHECK(require_ok(parse("sampling: {\"period\": \"500ms\"}\n" + least)).sampling.period == 500ms);
}

TEST_CASE("a default window is no longer than the period") {
  CHECK(require_ok(parse("sampling: {period: 500ms}\n" + least)).sampling.window == 500ms);
}

TEST_CASE("the example in systemd/ is valid, and the defaults that it documents are right") {
  std::ifstream in(std::filesystem::path(std::getenv("CALIBD_SOURCE_DIR")) / "systemd" / "calibd.yaml");
  const Config config = require_ok(parse({std::istreambuf_iterator<char>(in), {}}));
  const Config defaults = require_ok(parse(least));
  CHECK(config.vehicle == "demo-car");
  CHECK(config.dds.interface == defaults.dds.interface);
  CHECK((config.sampling.window == defaults.sampling.window && config.sampling.period == defaults.sampling.period));
  CHECK(config.pairs[0].camera.frame_id.name == defaults.pairs[0].camera.frame_id.name);
  const DepthRange range = config.pairs[0].depth_range, usual = defaults.pairs[0].depth_range;
  CHECK((range.min_m == usual.min_m && range.max_m == usual.max_m));
  CHECK(config.pairs[0].depth_timeout == defaults.pairs[0].depth_timeout);
  CHECK(config.pairs[0].drift.baseline_pairs == defaults.pairs[0].drift.baseline_pairs);
  CHECK(config.pairs[0].drift.false_alerts_per_1000_vehicle_weeks ==
        defaults.pairs[0].drift.false_alerts_per_1000_vehicle_weeks);
  CHECK(config.pairs[0].drift.driving_hours_per_week == defaults.pairs[0].drift.driving_hours_per_week);
  CHECK(config.pairs[0].drift.must_detect_rad == defaults.pairs[0].drift.must_detect_rad);
  CHECK(config.pairs[0].recalibration.min_interval == defaults.pairs[0].recalibration.min_interval);
  CHECK(config.pairs[0].recalibration.mode == defaults.pairs[0].recalibration.mode);
  CHECK(config.pairs[0].recalibration.frames == defaults.pairs[0].recalibration.frames);
  CHECK(config.pairs[0].recalibration.max_rotation_rad == defaults.pairs[0].recalibration.max_rotation_rad);
  CHECK(config.pairs[0].recalibration.max_translation_m == defaults.pairs[0].recalibration.max_translation_m);
}

TEST_CASE("a wrong value is refused with its file, line and key") {
  struct Wrong {
    std::string what, instead, refusal;
  };
  const Wrong wrongs[] = {
      {"demo-car", "demo car", "c.yaml:1: vehicle: "},
      {"demo-car", "[a]", "c.yaml:1: vehicle: needs text"},
      {"demo-car", "\"a\\x07\"", "c.yaml:1: vehicle: "},
      {"vehicle: demo-car", "vehicle:", "c.yaml:1: vehicle: needs text"},
      {"/var/lib/calibd", "calibd", "c.yaml:2: state_dir: needs an absolute path"},
      {"/run/calibd", "run", "c.yaml:3: runtime_dir: needs an absolute path"},
      {"domain: 3", "domain: 231", "c.yaml:5: dds.domain: 231 is outside 0 .. 230"},
      {"domain: 3", "domain: -1", "c.yaml:5: dds.domain: "},
      {"domain: 3", "domain: 3.5", "c.yaml:5: dds.domain: needs a whole number"},
      {"domain: 3", "domain: \"3\"", "c.yaml:5: dds.domain: needs a whole number"},
      {"domain: 3", "domain: 99999999999999999999", "c.yaml:5: dds.domain: needs a whole number"},
      {"interface: lo", "interface: '\"/><a'", "c.yaml:6: dds.interface: "},
      {"/etc/calibd/signing.key", "key", "c.yaml:7: signing_key: needs an absolute path"},
      {"2min", "10", "c.yaml:9: sampling.period: needs a duration"},
      {"2min", "min", "c.yaml:9: sampling.period: needs a duration"},
      {"2min", "2 min", "c.yaml:9: sampling.period: needs a duration"},
      {"2min", "-2min", "c.yaml:9: sampling.period: -2min is outside"},
      {"2min", "99ms", "c.yaml:9: sampling.period: 99ms is outside 0.1s .. 86400s"},
      {"2min", "1e300h", "c.yaml:9: sampling.period: 1e300h is outside"},
      {"2min", "nans", "c.yaml:9: sampling.period: needs a duration"},
      {"2min", "1s", "c.yaml:10: sampling.window: 1.5s is outside 0.05s .. 1s"},
      {"20ms", "2s", "c.yaml:11: sampling.max_time_difference: "},
      {"name: front", "name: Front", "c.yaml:13: pairs[0].name: "},
      {"name: front", "name: " + std::string(65, 'a'), "c.yaml:13: pairs[0].name: "},
      {"image: /left/image", "image: left/image", "c.yaml:15: pairs[0].camera.image: a topic"},
      {"/right/image", "/left/image", "c.yaml:30: pairs[0].depth.right_image: is the same topic"},
      {"info: /left/camera_info", "info: 'dds:'", "c.yaml:16: pairs[0].camera.info: "},
      {"camera_left/optical", "camera left", "c.yaml:17: pairs[0].camera.frame_id: "},
      {"model: rectified", "model: fishy", "c.yaml:18: pairs[0].camera.model: "},
      {"[1242, 375]", "[1242]", "c.yaml:19: pairs[0].camera.size: needs width and height"},
      {"[1242, 375]", "1242x375", "c.yaml:19: pairs[0].camera.size: needs a list"},
      {"[1242, 375]", "[1242, 8]", "c.yaml:19: pairs[0].camera.size[1]: 8 is outside"},
      {"[1242, 375]", "[60000, 60000]", "c.yaml:19: pairs[0].camera.size: "},
      {"721.5, 722", "721.5", "c.yaml:20: pairs[0].camera.intrinsics: needs a list of 4 numbers"},
      {"721.5, 722", "721.5, f", "c.yaml:20: pairs[0].camera.intrinsics[1]: needs a number"},
      {"721.5, 722", "721.5, .nan", "c.yaml:20: pairs[0].camera.intrinsics[1]: needs a number"},
      {"721.5, 722", "721.5, inf", "c.yaml:20: pairs[0].camera.intrinsics[1]: needs a number"},
      {"721.5, 722", "721.5, 0.5", "c.yaml:20: pairs[0].camera.intrinsics: focal length"},
      {"distortion: []", "distortion: [-0.3]", "c.yaml:21: pairs[0].camera.distortion: model rectified"},
      {"distortion: []", "distortion: none", "c.yaml:21: pairs[0].camera.distortion: needs a list"},
      {"model: rectified", "model: plumb_bob", "c.yaml:21: pairs[0].camera.distortion: model plumb_bob needs"},
      {"0.5327", "0", "c.yaml:31: pairs[0].depth.baseline_m: 0 is outside 0.01 .. 10"},
      {"/lidar/points", "/lidar/", "c.yaml:23: pairs[0].lidar.cloud: "},
      {"lidar_top", "''", "c.yaml:24: pairs[0].lidar.frame_id: "},
      {"[0.1, -0.2, 0.3]", "[0.1, -0.2]", "c.yaml:26: pairs[0].T_camera_lidar.translation_m: "},
      {"[0.1, -0.2, 0.3]", "[0.1, -0.2, 101]", "c.yaml:26: pairs[0].T_camera_lidar.translation_m[2]: "},
      {"[0.5, -0.5, 0.5, 0.5]", "[0, 0, 0, 0]", "c.yaml:27: pairs[0].T_camera_lidar.quaternion_xyzw: "},
      {"[0.5, -0.5, 0.5, 0.5]", "[0.5, 0.5, 0.5, 0.503]", "c.yaml:27: pairs[0].T_camera_lidar.quaternion_xyzw: "},
      {"stereo", "guess", "c.yaml:29: pairs[0].depth.source: is none of: stereo, onnx, topic"},
      {"/right/image", "right", "c.yaml:30: pairs[0].depth.right_image: a topic"},
      {"matcher: bm", "matcher: best", "c.yaml:32: pairs[0].depth.matcher: is none of: sgbm, bm"},
      {"[1, 80]", "[1]", "c.yaml:33: pairs[0].depth.range_m: needs a list of 2 numbers"},
      {"[1, 80]", "[80, 1]", "c.yaml:33: pairs[0].depth.range_m: needs the least"},
      {"[1, 80]", "[-1, 80]", "c.yaml:33: pairs[0].depth.range_m[0]: -1 is outside"},
      {"timeout: 5s", "timeout: 5h", "c.yaml:34: pairs[0].depth.timeout: 5h is outside 0.1s .. 60s"},
      {"baseline_pairs: 30", "baseline_pairs: 4", "c.yaml:36: pairs[0].drift.baseline_pairs: "},
      {"weeks: 2.5", "weeks: 0", "c.yaml:37: pairs[0].drift.false_alerts_per_1000_vehicle_weeks: "},
      {"per_week: 40", "per_week: 169", "c.yaml:38: pairs[0].drift.driving_hours_per_week: "},
      {"notice_deg: 1", "notice_deg: 0", "c.yaml:39: pairs[0].drift.must_notice_deg: "},
      {"within: 45min", "within: 5min", "c.yaml:40: pairs[0].drift.notice_within: 5min is outside"},
      {"scene_change: 0.4", "scene_change: 1.1", "c.yaml:41: pairs[0].drift.min_scene_change: "},
      {"mode: apply", "mode: maybe", "c.yaml:43: pairs[0].recalibration.mode: is none of: apply, propose"},
      {"frames: 40", "frames: 4", "c.yaml:44: pairs[0].recalibration.frames: "},
      {"max_rotation_deg: 3", "max_rotation_deg: 31", "c.yaml:45: pairs[0].recalibration.max_rotation_deg: "},
      {"max_translation_cm: 20", "max_translation_cm: 0", "c.yaml:46: pairs[0].recalibration.max_translation_cm: "},
      {"interval: 5min", "interval: 25h", "c.yaml:47: pairs[0].recalibration.min_interval: "},
  };
  for (const Wrong& wrong : wrongs) {
    INFO(wrong.what << " -> " << wrong.instead);
    CHECK_THAT(refusal(with(wrong.what, wrong.instead)), Catch::Matchers::StartsWith(wrong.refusal));
  }
}

TEST_CASE("the parameters of a lens are checked, and baseline_m is for rectified images only") {
  const auto lens = [](const std::string& model, const std::string& distortion) {
    std::string yaml = with("model: rectified", "model: " + model);
    return refusal(yaml.replace(yaml.find("distortion: []"), 14, "distortion: [" + distortion + "]"));
  };
  for (const auto& [model, distortion] : std::vector<std::pair<std::string, std::string>>{
           {"plumb_bob", "-0.3, 0.1, 0.001, 0.002, 0"},
           {"rational_polynomial", "0.6, -2.7, 0.001, 0, 1.6, 0.5, -2.5, 1.5"},
           {"equidistant", "0.02, -0.006, 0.001, 0"},
           {"double_sphere", "-0.2, 0.6"},
           {"eucm", "0.6, 1.1"},
           {"mei", "2.2, 0.02, 1.7, 0, 0"}}) {
    INFO(model);
    CHECK(lens(model, distortion) ==
          "c.yaml:31: pairs[0].depth.baseline_m: is for rectified images, and camera.model is " + model +
              "; write right_camera or right_info instead");
    CHECK_THAT(lens(model, "0.5"),
               Catch::Matchers::StartsWith("c.yaml:21: pairs[0].camera.distortion: model " + model + " needs"));
  }
  CHECK_THAT(lens("double_sphere", "0.6, -0.2"),
             Catch::Matchers::StartsWith("c.yaml:21: pairs[0].camera.distortion: model double_sphere has alpha"));
}

TEST_CASE("an unknown key is refused with its line, in every mapping") {
  const std::pair<std::string, std::string> places_in_file[] = {
      {"state_dir:", "c.yaml:2: surprise: unknown key; known keys are vehicle, "},
      {"  domain:", "c.yaml:5: dds.surprise: unknown key"},
      {"  period:", "c.yaml:9: sampling.surprise: unknown key"},
      {"    camera:", "c.yaml:14: pairs[0].surprise: unknown key"},
      {"      image:", "c.yaml:15: pairs[0].camera.surprise: unknown key"},
      {"      cloud:", "c.yaml:23: pairs[0].lidar.surprise: unknown key"},
      {"      translation_m:", "c.yaml:26: pairs[0].T_camera_lidar.surprise: unknown key"},
      {"      source:", "c.yaml:29: pairs[0].depth.surprise: unknown key"},
      {"      baseline_pairs:", "c.yaml:36: pairs[0].drift.surprise: unknown key"},
      {"      mode:", "c.yaml:43: pairs[0].recalibration.surprise: unknown key"},
  };
  for (const auto& [before, expected] : places_in_file) {
    const std::string indent(before.find_first_not_of(' '), ' ');
    CHECK_THAT(refusal(with(before, indent + "surprise: 1\n" + before)), Catch::Matchers::StartsWith(expected));
  }
}

TEST_CASE("a repeated key is refused, with the line of its second appearance") {
  CHECK(refusal(with("state_dir:", "vehicle: other\nstate_dir:")) == "c.yaml:2: vehicle: given twice; remove one");
  CHECK(refusal(with("      source:", "      source: stereo\n      source:")) ==
        "c.yaml:30: pairs[0].depth.source: given twice; remove one");
}

TEST_CASE("a missing key is refused, with the line of the mapping that lacks it") {
  const std::pair<std::string, std::string> missing[] = {
      {"vehicle: demo-car\n", "vehicle: missing; add it"},
      {"name: front\n    camera:", "pairs[0].name: missing"},
      {"      image: /left/image\n", "pairs[0].camera.image: missing"},
      {"      right_image: /right/image\n", "pairs[0].depth.right_image: missing"},
      {"      model: rectified\n", "pairs[0].camera.model: missing"},
      {"      size: [1242, 375]\n", "pairs[0].camera.size: missing"},
      {"      intrinsics: [721.5, 722, 609.5, 172.8]\n", "pairs[0].camera.intrinsics: missing"},
      {"      baseline_m: 0.5327\n", "pairs[0].depth: needs one of baseline_m (rectified images), right_camera and"},
      {"      cloud: /lidar/points\n", "pairs[0].lidar.cloud: missing"},
      {"      translation_m: [0.1, -0.2, 0.3]\n", "pairs[0].T_camera_lidar.translation_m: missing"},
      {"      quaternion_xyzw: [0.5, -0.5, 0.5, 0.5]\n", "pairs[0].T_camera_lidar.quaternion_xyzw: missing"},
      {"      source: stereo\n", "pairs[0].depth.source: missing"},
  };
  for (const auto& [what, expected] : missing) {
    const std::string yaml = with(what, what.starts_with("name") ? "camera:" : "");
    CHECK_THAT(refusal(yaml), Catch::Matchers::ContainsSubstring(": " + expected));
  }
  CHECK(refusal("vehicle: car\n") == "c.yaml:1: pairs: missing; add it");
  for (const std::string key : {"state_dir", "runtime_dir", "signing_key"}) {
    const auto config = parse_config(with(key + ": ", "# "), "c.yaml", {});
    REQUIRE_FALSE(config);
    CHECK(config.error().context == "c.yaml:1: " + key + ": missing; add it");
  }
}

TEST_CASE("there are 1 .. 16 pairs, each with its own name") {
  const std::string pair = least.substr(least.find("  - name"));
  CHECK_THAT(refusal(least + pair),
             Catch::Matchers::StartsWith("c.yaml:8: pairs[1].name: is the name of an earlier pair"));
  CHECK_THAT(refusal("vehicle: car\npairs: []\n"), Catch::Matchers::StartsWith("c.yaml:2: pairs: needs 1 .. 16 pairs"));
  std::string many = "vehicle: car\npairs:\n";
  for (int i = 0; i < 16; ++i) {
    std::string next = pair;
    many += next.replace(next.find("front"), 5, "pair" + std::to_string(i));
  }
  CHECK(require_ok(parse(many)).pairs.size() == 16);
  CHECK_THAT(refusal(many + pair), Catch::Matchers::ContainsSubstring("pairs: needs 1 .. 16 pairs"));
}

TEST_CASE("a file that is not one YAML mapping is refused with a line") {
  CHECK_THAT(refusal("vehicle: [\n"), Catch::Matchers::StartsWith("c.yaml:2: not YAML: "));
  CHECK_THAT(refusal("a: b: c\n"), Catch::Matchers::StartsWith("c.yaml:1: not YAML: "));
  CHECK_THAT(refusal(""), Catch::Matchers::StartsWith("c.yaml:1: "));
  CHECK_THAT(refusal("- a\n"), Catch::Matchers::StartsWith("c.yaml:1: needs a mapping"));
  CHECK_THAT(refusal("[a, b]: c\n"), Catch::Matchers::StartsWith("c.yaml:1: holds a key"));
  CHECK_THAT(refusal(least + "---\n" + least), Catch::Matchers::StartsWith("c.yaml:1: the file must hold one"));
  for (const std::string stray : {",", "]", "}", ", a: b"})
    CHECK_THAT(refusal(stray), Catch::Matchers::StartsWith("c.yaml:1: "));
  CHECK_THAT(refusal("<<: {vehicle: car}\n"), Catch::Matchers::StartsWith("c.yaml:1: <<: unknown key"));
  CHECK_THAT(refusal(std::string((1 << 20) + 1, '#')), Catch::Matchers::StartsWith("c.yaml:1: is larger than 1 MiB"));
  CHECK_THAT(refusal("vehicle: " + std::string(100'000, '[')), Catch::Matchers::StartsWith("c.yaml:1: "));
}

TEST_CASE("an alias is a value like any other, and exponentially nested aliases are harmless") {
  CHECK(parse(with("lidar_top", "&frame lidar_top")));
  std::string bomb = "a0: &a0 [x, x, x, x, x, x, x, x, x]\n";
  for (int i = 1; i < 30; ++i) {
    const std::string before = "*a" + std::to_string(i - 1);
    bomb += "a" + std::to_string(i) + ": &a" + std::to_string(i) + " [" + before + "," + before + "," + before + "]\n";
  }
  CHECK_THAT(refusal(bomb), Catch::Matchers::StartsWith("c.yaml:1: a0: unknown key"));
  CHECK_THAT(refusal(bomb.replace(0, 2, "vehicle")), Catch::Matchers::StartsWith("c.yaml:2: a1: unknown key"));
  CHECK_THAT(refusal("vehicle: &self [*self]\npairs: *self\n"), Catch::Matchers::StartsWith("c.yaml:1: "));
}

TEST_CASE("a missing file is reported as such") {
  const TemporaryFolder folder;
  CHECK(load_config(folder.path() / "none.yaml", places).error().code == "config_not_found");
  CHECK(load_config(folder.path(), places).error().code == "config_not_found");
  std::ofstream(folder.path() / "c.yaml") << least;
  CHECK(require_ok(load_config(folder.path() / "c.yaml", places)).sha256 == sha256_hex(least));
}
