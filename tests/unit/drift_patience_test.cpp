// Small shifts take many pairs; scenes, not pairs, are evidence; and roads differ.
#include "calib/drift.hpp"
#include "support/catch.hpp"
#include "unit/drift_vehicle.hpp"

using namespace calib;
using test::keen;
using test::pairs_until_drifted;
using test::Vehicle;

TEST_CASE("a shift of half a deviation is found within the time that the settings give, and so is a creeping one",
          "[release-only]") {
  for (const double per_pair : {0.0, 0.001})  // steps
    for (std::uint64_t seed = 0; seed < 20; ++seed) {
      Vehicle vehicle(seed);
      DriftMonitor monitor(keen);
      vehicle.drive(monitor, 1000);
      REQUIRE(monitor.detection_limit(1) < 0.5 * Vehicle::noise * StencilStep{}.of_axis(1));
      if (per_pair == 0) vehicle.offset[1] = 0.5 * Vehicle::noise;
      int pairs = 0;
      for (; pairs < keen.pairs_to_detect && monitor.verdict() != DriftVerdict::drifted; ++pairs) {
        vehicle.offset[1] += per_pair;
        vehicle.drive(monitor, 1);
      }
      CAPTURE(per_pair, seed, pairs);
      CHECK(monitor.verdict() == DriftVerdict::drifted);
    }
}

TEST_CASE("a small shift soon after the baseline was learned does not become part of it", "[release-only]") {
  DriftSettings settings = keen;
  settings.baseline_pairs = 120;
  for (std::uint64_t seed = 0; seed < 100; ++seed) {
    Vehicle vehicle(seed);
    DriftMonitor monitor(settings);
    vehicle.drive(monitor, settings.baseline_pairs);
    const auto axis = static_cast<Eigen::Index>(seed % 6);
    vehicle.offset[axis] = (seed % 2 == 0 ? 0.9 : -0.9) * Vehicle::noise;
    CAPTURE(seed, monitor.state().baseline.pairs);
    CHECK(pairs_until_drifted(vehicle, monitor, static_cast<int>(settings.pairs_to_detect)) < settings.pairs_to_detect);
  }
}

TEST_CASE("what is above the detection limit is found, and does not become part of the baseline", "[release-only]") {
  for (const int baseline_pairs : {20, 120}) {
    DriftSettings settings = keen;
    settings.baseline_pairs = baseline_pairs;
    int missed = 0;
    for (std::uint64_t seed = 0; seed < 100; ++seed) {
      Vehicle vehicle(seed);
      DriftMonitor monitor(settings);
      vehicle.drive(monitor, baseline_pairs + 20);
      const auto axis = static_cast<int>(seed % 6);
      vehicle.offset[axis] = 1.2 * monitor.detection_limit(axis) / StencilStep{}.of_axis(axis);
      missed += pairs_until_drifted(vehicle, monitor, 2000) == 2000;
    }
    CAPTURE(baseline_pairs);
    CHECK(missed <= 5);
  }
}

TEST_CASE("a verdict stands on its own baseline where the settings ask for a larger one since") {
  Vehicle vehicle(18);
  DriftMonitor before(keen);
  REQUIRE(vehicle.drive(before, 60) == DriftVerdict::calibrated);
  DriftSettings larger = keen;
  larger.baseline_pairs = 120;
  DriftMonitor after(larger, before.state());
  vehicle.offset[2] = 6 * Vehicle::noise;
  CHECK(pairs_until_drifted(vehicle, after, 20) < 20);
}

TEST_CASE("pairs of one scene are one piece of evidence, however many they are and whatever they show") {
  vehicle::Random random(14);
  for (std::uint64_t seed = 0; seed < 50; ++seed) {
    Vehicle vehicle(seed);
    DriftMonitor monitor({}), once({});
    for (int scene = 0; scene < 60; ++scene) {
      const AxisEvidence first = vehicle.see();
      REQUIRE(*monitor.observe(first) == *once.observe(first));
      Vehicle jam = vehicle;  // errs by the same, again and again
      jam.offset[random.below(6)] = random.uniform(-3, 3);
      for (int repeat = random.below(monitor.learned() ? 29 : 500); repeat > 0; --repeat) {
        AxisEvidence again = jam.see();
        again.same_scene = true;
        REQUIRE(*monitor.observe(again) == once.verdict());
      }
    }
    CHECK(monitor.state().charts == once.state().charts);
    CHECK(monitor.state().baseline.slope == once.state().baseline.slope);
    CHECK(monitor.reason() == once.reason());
  }
}

TEST_CASE(
    "a vehicle that never leaves a scene learns no baseline, and one that stays in it for long is still watched") {
  Vehicle vehicle(15);
  vehicle.offset.setConstant(1.9);
  DriftMonitor in_jam({}), monitor({});
  for (int pair = 0; pair < 5000; ++pair) {
    AxisEvidence evidence = vehicle.see();
    evidence.same_scene = true;
    REQUIRE(*in_jam.observe(evidence) == DriftVerdict::learning);
  }
  CHECK(in_jam.reason() == "learning the baseline: 1 of 20 scenes");
  CHECK(in_jam.state().repeats == 0);  // a count without an end could not be restored
  vehicle.offset.setZero();
  vehicle.drive(monitor, 100);
  vehicle.offset[1] = 1;
  int pairs = 0;
  for (; pairs < 1000 && monitor.verdict() != DriftVerdict::drifted; ++pairs) {
    AxisEvidence evidence = vehicle.see();
    evidence.same_scene = true;
    REQUIRE(monitor.observe(evidence));
  }
  CHECK(pairs > 60);
  CHECK(pairs <= 200);
}

TEST_CASE("roads that differ raise no alarm once their differences are known", "[release-only]") {
  // On each road, of an hour, depth errs by another fifth of a deviation.
  vehicle::Random random(16);
  int alarms = 0;
  for (std::uint64_t seed = 0; seed < 20; ++seed) {
    Vehicle vehicle(seed);
    DriftMonitor monitor({});
    for (int road = 0; road < 100; ++road) {
      for (int axis = 0; axis < 6; ++axis) vehicle.offset[axis] = 0.2 * Vehicle::noise * random.gaussian();
      const bool before = monitor.verdict() == DriftVerdict::drifted;
      const bool after = vehicle.drive(monitor, 360) == DriftVerdict::drifted;
      alarms += road >= 10 && after && !before;
    }
  }
  CHECK(alarms == 0);
}

TEST_CASE("a baseline that is merged from batches is that of all their pairs") {
  Vehicle vehicle(17);
  DriftBaseline all, merged;
  merged.merge({});
  CHECK(merged.pairs == 0);
  for (const int pairs : {20, 1, 7, 100, 30}) {
    DriftBaseline batch;
    for (int pair = 0; pair < pairs; ++pair) {
      AxisEvidence evidence = vehicle.see();
      if (pair % 3 == 0) evidence.sensitivity.reset();
      all.add(evidence);
      batch.add(evidence);
    }
    merged.merge(batch);
  }
  CHECK(merged.pairs == 158);
  CHECK(merged.sensitivities == all.sensitivities);
  CHECK(merged.slope.isApprox(all.slope));
  CHECK(merged.slope_products.isApprox(all.slope_products));
  CHECK(merged.sensitivity.isApprox(all.sensitivity));
  CHECK(merged.sensitivity_squares.isApprox(all.sensitivity_squares));
  CHECK(merged.prominence == Approx(all.prominence));
  CHECK(merged.prominence_squares == Approx(all.prominence_squares));
  CHECK(merged.score == Approx(all.score));
  CHECK(merged.score_squares == Approx(all.score_squares));
  CHECK(merged.latest_slope == all.latest_slope);
  // What two batches have in common is only known of their means.
  CHECK((merged.lag1_products - all.lag1_products).cwiseAbs().maxCoeff() <
        0.1 * all.slope_products.diagonal().maxCoeff());
}
