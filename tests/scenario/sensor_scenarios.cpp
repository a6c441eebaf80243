// What sensors do that are not well, or see nothing of use. The LiDAR stays where it is.
#include <algorithm>

#include "support/catch.hpp"
#include "support/pair_scenario.hpp"
#include "vehicle/random.hpp"

using namespace calib;
using namespace calib::test;
using namespace std::chrono_literals;

namespace {

void dim(Image& image, int divisor) {
  for (std::uint8_t& pixel : image.pixels) pixel = static_cast<std::uint8_t>(pixel / divisor);
}

struct Trouble {
  const char* code;
  World world;
};

const std::vector<Trouble> troubles{
    {"dark", {.samples = [](FramePair& pair) { dim(pair.image, 40), dim(*pair.right_image, 40); }}},
    {"low_overlap", {.motion = moved(0, 0, 180)}},
    {"sensor_silent", {.lidar = false}},
    {"sensor_silent", {.camera = false}},
    {"standing_still", {.frozen = true}},
    {"time_difference", {.lidar_clock = 80ms}},
    {"few_valid_depth", {.depth = [](DepthMap& depth) { std::ranges::fill(depth.inverse_depth, DepthMap::no_depth); }}},
};

/// Most LiDAR returns are lost, some are drops nearby, and the lens is wet here and there.
void rain(FramePair& pair) {
  vehicle::Random random(pair.scan.points.size() + pair.image.pixels[12'345]);
  std::vector<LidarPoint> points;
  for (LidarPoint point : pair.scan.points) {
    if (random.chance(0.4F)) continue;
    if (random.chance(0.05F)) {
      const float nearer = random.uniform(0.05F, 0.4F);
      point = {point.x_m * nearer, point.y_m * nearer, point.z_m * nearer, 1};
    }
    points.push_back(point);
  }
  pair.scan.points = std::move(points);
  for (Image* image : {&pair.image, &*pair.right_image})
    for (int drop = 0; drop < 12; ++drop) {
      const int x = random.below(image->width - 24), y = random.below(image->height - 24);
      for (int row = y; row < y + 24; ++row)
        std::fill_n(image->pixels.begin() + row * image->width + x, 24, std::uint8_t{128});
    }
}

}  // namespace

TEST_CASE(
    "after two windows without evidence nothing is said of the extrinsic, but why; with the next good one all is as "
    "before") {
  const Trouble& trouble = troubles[GENERATE(range(0, 7))];
  INFO(trouble.code);
  PairScenario scenario;
  scenario.drive(3);
  if (trouble.world.frozen) scenario.drive(1, trouble.world);  // the first picture of many
  const std::uint64_t before = scenario.skipped(trouble.code);
  scenario.drive(1, trouble.world);
  CHECK(scenario.verdict() == Verdict::calibrated);
  CHECK(scenario.alerts() == 0);
  scenario.drive(29, trouble.world);
  CHECK(scenario.verdict() == Verdict::not_evaluated);
  CHECK_THAT(scenario.reason(), Catch::Matchers::StartsWith(std::string(trouble.code) + ": "));
  CHECK(scenario.skipped(trouble.code) == before + 30);
  CHECK((scenario.alerts() == 1 && scenario.alerts(Verdict::not_evaluated) == 1));
  scenario.drive(40);
  CHECK(scenario.verdict() == Verdict::calibrated);
  CHECK((scenario.alerts() == 2 && scenario.alerts(Verdict::calibrated) == 1));
  CHECK(scenario.records(Decision::accepted) + scenario.records(Decision::rejected) == 0);
}

TEST_CASE("a drift that was seen is not forgotten while nothing is evaluated") {
  PairScenario scenario({.mode = RecalibrationMode::propose});
  REQUIRE(scenario.drive_until(Verdict::drifted, 30, {.motion = moved(0, 0.5, 0)}) <= 30);
  scenario.drive(2, {.motion = moved(0, 0.5, 0), .lidar = false});
  CHECK(scenario.verdict() == Verdict::not_evaluated);
  CHECK_THAT(scenario.reason(), Catch::Matchers::StartsWith("sensor_silent: ") &&
                                    Catch::Matchers::EndsWith("it was drifted when last evaluated"));
  CHECK(scenario.drive_until(Verdict::drifted, 1, {.motion = moved(0, 0.5, 0)}) == 1);
}

TEST_CASE("rain raises no alert of drift, and what it hides it does not invent") {
  PairScenario scenario;
  scenario.drive(60, {.samples = rain});
  scenario.drive(20);
  INFO(scenario.reason());
  CHECK(scenario.alerts(Verdict::drifted) == 0);
  CHECK(scenario.records(Decision::accepted) + scenario.records(Decision::rejected) == 0);
  CHECK(scenario.verdict() == Verdict::calibrated);
}

TEST_CASE("a lorry that hides half of the view for a while is no drift") {
  PairScenario scenario;
  const auto lorry = [](FramePair& pair) {
    for (Image* image : {&pair.image, &*pair.right_image})
      for (int row = 0; row < image->height; ++row)
        for (int column = 0; column < image->width / 2; ++column)
          image->pixels[static_cast<std::size_t>(row * image->width + column)] =
              static_cast<std::uint8_t>(60 + 12 * ((column / 7 + row / 5) % 4));
    // As flat and as near as it looks: 6 m ahead, to the left.
    for (LidarPoint& point : pair.scan.points)
      if (point.y_m > 0 && point.x_m > 6) {
        const float nearer = 6 / point.x_m;
        point = {6, point.y_m * nearer, point.z_m * nearer, point.reflectance};
      }
  };
  scenario.drive(4, {.samples = lorry});
  scenario.drive(40);
  INFO(scenario.reason());
  CHECK(scenario.alerts(Verdict::drifted) == 0);
  CHECK(scenario.records(Decision::accepted) + scenario.records(Decision::rejected) == 0);
  CHECK(scenario.verdict() == Verdict::calibrated);
}

TEST_CASE("an image that comes again is not evidence twice, however its scan is stamped, and over a restart") {
  PairScenario scenario;
  const World late{.lidar_clock = 20ms};
  World again = late;
  again.repeating = true;
  scenario.drive(3, late);
  const std::uint64_t evaluated = scenario.state().evaluated;
  scenario.drive(1, again);
  CHECK(scenario.skipped("duplicate_frame") == 1);
  scenario.restart();  // what the last scene looked like is forgotten, its stamp is not
  scenario.drive(2, again);
  CHECK(scenario.skipped("duplicate_frame") == 3);
  CHECK(scenario.state().evaluated == evaluated);
  CHECK(scenario.status().verdict == Verdict::not_evaluated);
  scenario.drive(3, late);
  CHECK(scenario.state().evaluated == evaluated + 3);
}
