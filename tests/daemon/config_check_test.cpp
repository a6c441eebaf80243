#include "config_check.hpp"

#include <filesystem>
#include <fstream>

#include "calib/signature.hpp"
#include "support/catch.hpp"
#include "support/support.hpp"

using namespace calib;
using namespace calib::test;
namespace fs = std::filesystem;

namespace {

Config config_with(const std::string& intrinsics, const std::string& translation, const std::string& key = "",
                   const std::string& dds = "{}") {
  const std::string text =
      "vehicle: car\nstate_dir: /s\nruntime_dir: /r\ndds: " + dds + "\n" +
      (key.empty() ? "" : "signing_key: " + key + "\n") +
      "pairs:\n  - name: front\n    camera: {image: /i, bits: 12, model: rectified, size: [640, 480], "
      "intrinsics: " +
      intrinsics + "}\n    lidar: {cloud: /c}\n    T_camera_lidar: {translation_m: " + translation +
      ", quaternion_xyzw: [0.5, -0.5, 0.5, 0.5]}\n    depth: {source: stereo, right_image: /r, "
      "baseline_m: 0.5}\n";
  return require_ok(parse_config(text, "c.yaml", {.credentials = fs::path("/none")}));
}

std::string refusal(const Config& config) {
  const auto checked = check_files(config);
  return checked ? "" : std::string(to_string(checked.error().code)) + ": " + checked.error().context;
}

}  // namespace

TEST_CASE("what is surely a slip is named with its key and its value") {
  CHECK(probable_slips(config_with("[500, 500, 320, 240]", "[0, 0, 1]")).empty());
  const auto outside = probable_slips(config_with("[500, 500, 1320, 240]", "[0, 0, 1]"));
  REQUIRE(outside.size() == 1);
  CHECK_THAT(outside[0],
             Catch::Matchers::StartsWith(
                 "pairs[0].camera.intrinsics: the principal point 1320, 240 is outside the image of 640 x 480"));
  CHECK(probable_slips(config_with("[500, 320, 320, 240]", "[0, 0, 1]")).size() == 1);
  const auto apart = probable_slips(config_with("[500, 500, 320, 240]", "[0, 0, 99]"));
  REQUIRE(apart.size() == 1);
  CHECK_THAT(apart[0], Catch::Matchers::Contains("99 m apart; is it in millimetres?"));
}

TEST_CASE("the key that a configuration names is loaded, as calibd would at its start") {
  TemporaryFolder folder;
  const fs::path file = folder.path() / "signing.key";
  const auto with = [&](const fs::path& key) { return config_with("[500, 500, 320, 240]", "[0, 0, 1]", key.string()); };
  CHECK_THAT(refusal(with(file)), Catch::Matchers::StartsWith("key_not_found: signing_key: ") &&
                                      Catch::Matchers::EndsWith("calibctl keygen --out " + file.string() + "`"));
  require_ok(SigningKey::generate().save(file));
  CHECK(refusal(with(file)).empty());
  CHECK_THAT(refusal(with(folder.path() / "signing.pub")), Catch::Matchers::Contains("signing_key: "));
  fs::permissions(file, fs::perms::others_read, fs::perm_options::add);
  CHECK_THAT(refusal(with(file)), Catch::Matchers::StartsWith("key_permissions: signing_key: "));
  // One that the service manager will pass is not there yet.
  CHECK(refusal(config_with("[500, 500, 320, 240]", "[0, 0, 1]")).empty());
}

TEST_CASE("peers are addresses, and take the place of multicast") {
  const auto dds = [](const std::string& text) {
    return config_with("[500, 500, 320, 240]", "[0, 0, 1]", "", text).dds;
  };
  CHECK((dds("{}").multicast && dds("{}").peers.empty()));
  const DdsConfig unicast = dds("{multicast: false, peers: [192.168.1.7, host.local, 'fe80::1']}");
  CHECK_FALSE(unicast.multicast);
  CHECK(unicast.peers == std::vector<std::string>{"192.168.1.7", "host.local", "fe80::1"});
  CHECK(config_with("[500, 500, 320, 240]", "[0, 0, 1]").pairs[0].camera.bits == 12);
}
