// That nothing starts with values that are of no vehicle.
#include "config.hpp"

#include <cstdlib>
#include <fstream>
#include <iterator>

#include "support/catch.hpp"
#include "support/support.hpp"

using namespace calib;
using namespace calib::test;

namespace {

std::string example() {
  std::ifstream in(std::filesystem::path(std::getenv("CALIBD_SOURCE_DIR")) / "systemd" / "calibd.yaml");
  return {std::istreambuf_iterator<char>(in), {}};
}

}  // namespace

TEST_CASE("calibd does not start with the example's values, and with any of a vehicle's own it does") {
  const TemporaryFolder folder;
  const auto file = folder.path() / "c.yaml";
  const auto load = [&](const std::string& from, const std::string& to) {
    std::string text = example();
    REQUIRE(text.find(from) != std::string::npos);
    std::ofstream(file) << text.replace(text.find(from), from.size(), to);
    return load_config(file, {"/state", "/runtime", "/credentials"});
  };
  const auto untouched = load("period: 10s", "period: 20s");
  REQUIRE_FALSE(untouched);
  CHECK(untouched.error().code == "bad_config");
  CHECK_THAT(
      untouched.error().context,
      Catch::Matchers::StartsWith(file.string() + ": these are still the example's values; write your vehicle's"));
  CHECK(load("demo-car", "van-7"));
  CHECK(load("translation_m: [0, 0, 0]", "translation_m: [0, 0, -0.1]"));
  CHECK(load("/lidar/points", "/top/points"));
}
