// What becomes of a LiDAR that stays where it is, and of one that moves.
#include "support/catch.hpp"
#include "support/pair_scenario.hpp"

using namespace calib;
using namespace calib::test;

TEST_CASE("a vehicle that is new learns its baseline, signs it twice, and then says nothing more") {
  PairScenario scenario({.learned = false});
  scenario.drive(19);
  CHECK_THAT(scenario.reason(), Catch::Matchers::StartsWith("learning the baseline: 19 of 20 scenes; so far "));
  CHECK(scenario.alerts() == 0);
  scenario.drive(1);
  CHECK(scenario.records(Decision::baseline) == 1);
  scenario.drive(280);
  CHECK(scenario.verdict() == Verdict::calibrated);
  INFO(scenario.state().drift.baseline.pairs << " pairs");
  CHECK((scenario.alerts() == 1 && scenario.alerts(Verdict::calibrated) == 1));
  CHECK(scenario.records(Decision::initial) == 1);
  CHECK(scenario.records(Decision::baseline) == 2);
  CHECK(scenario.status().evaluated == 300);
}

TEST_CASE("without drift there is no alert and no record", "[release-only]") {
  PairScenario scenario;
  scenario.drive(300);
  CHECK(scenario.verdict() == Verdict::calibrated);
  CHECK(scenario.alerts() == 0);
  CHECK(scenario.records(Decision::baseline) + scenario.records(Decision::accepted) +
            scenario.records(Decision::rejected) ==
        0);
  for (int axis = 0; axis < 3; ++axis) CHECK((*scenario.status().detection_limit)[axis] < 0.5 * radians_per_degree);
}

TEST_CASE("a yaw that drifts by a tenth of a degree an hour is told before it is half a degree", "[release-only]") {
  PairScenario scenario({.mode = RecalibrationMode::propose});
  const int windows = scenario.drive_until(Verdict::drifted, 5 * 360,
                                           [](double hours) { return World{.motion = moved(0, 0, 0.1 * hours)}; });
  INFO(windows << " pairs: " << scenario.reason());
  CHECK(windows <= 5 * 360);
  CHECK(scenario.alerts(Verdict::suspect) == 1);
  CHECK(scenario.alerts(Verdict::drifted) == 1);
  CHECK(scenario.alerts() == 2);
  CHECK(scenario.status().misalignment->delta[2] ==
        Approx(windows * 0.1 / 360 * radians_per_degree).margin(0.15 * radians_per_degree));
}

TEST_CASE("half a degree about any axis is noticed at once, and put right") {
  const int axis = GENERATE(0, 1, 2);
  Vector6 motion = Vector6::Zero();
  motion[axis] = 0.5 * radians_per_degree;
  INFO(axis_names[axis]);
  PairScenario scenario;
  const int windows = scenario.drive_until(Verdict::drifted, 20, {.motion = motion});
  INFO(windows << " pairs");
  CHECK(windows <= 8);
  CHECK_THAT(scenario.reason(), Catch::Matchers::StartsWith("the LiDAR seems to have moved: "));
  scenario.drive(60, {.motion = motion});
  INFO(scenario.reason());
  CHECK(scenario.verdict() == Verdict::calibrated);
  CHECK(scenario.alerts(Verdict::drifted) == 1);
  CHECK(scenario.records(Decision::accepted) == 1);
  CHECK(scenario.records(Decision::rejected) == 0);
  CHECK(scenario.records(Decision::rolled_back) == 0);
  CHECK(scenario.records(Decision::baseline) == 1);
  CHECK(scenario.error_deg(motion) < 0.2);
  CHECK_FALSE(scenario.state().probation);
}

TEST_CASE("ten centimetres along any axis are noticed, or it is said that they are not") {
  const int axis = GENERATE(3, 4, 5);
  Vector6 motion = Vector6::Zero();
  motion[axis] = 0.1;
  PairScenario scenario({.mode = RecalibrationMode::propose});
  const double detection_limit_m = (*scenario.status().detection_limit)[axis];
  const int windows = scenario.drive_until(Verdict::drifted, 100, {.motion = motion});
  INFO(axis_names[axis] << ": detection limit " << detection_limit_m << " m, " << windows << " pairs");
  if (detection_limit_m < 0.1)
    CHECK(windows <= 100);
  else
    CHECK((*scenario.status().detection_limit)[axis] >= 0.1);
}

TEST_CASE("an extrinsic that is wrong from the start is never called calibrated, and put right") {
  const Vector6 wrong = moved(0, 1, -1);
  PairScenario scenario({.wrong_from_start = wrong, .learned = false});
  scenario.drive_until(Verdict::drifted, 20);
  CHECK(scenario.alerts(Verdict::calibrated) == 0);
  scenario.drive(60);
  INFO(scenario.reason());
  CHECK(scenario.verdict() == Verdict::calibrated);
  CHECK(scenario.records(Decision::accepted) == 1);
  CHECK(scenario.records(Decision::rolled_back) == 0);
  CHECK(scenario.error_deg(Vector6::Zero()) < 0.2);
}
