#include "calib/drift.hpp"
#include "support/catch.hpp"
#include "unit/drift_vehicle.hpp"

using namespace calib;
using test::pairs_until_drifted;
using test::Vehicle;

// What a reload of the configuration changes: the same state goes on with other settings.

TEST_CASE("a larger baseline that is asked for later does not learn a drift") {
  Vehicle vehicle(3);
  DriftMonitor before({});
  vehicle.drive(before, 60);
  REQUIRE(before.verdict() == DriftVerdict::calibrated);
  DriftState state = before.state();
  const int learned = state.baseline.pairs;
  vehicle.offset[2] = 2;
  for (int pair = 0; pair < 300; ++pair) {  // a monitor for each pair, as calibd makes them
    DriftMonitor monitor({.baseline_pairs = 200}, std::move(state));
    vehicle.drive(monitor, 1);
    state = monitor.state();
    REQUIRE(state.baseline.pairs <= learned + 24);  // of before the shift
    REQUIRE((pair < 20 || monitor.verdict() == DriftVerdict::drifted));
    if (monitor.onset()) REQUIRE(*monitor.onset() > Timestamp::min());
  }
}

TEST_CASE("a smaller baseline that is asked for later makes none of pairs that were wrong from the start") {
  Vehicle vehicle(4);
  vehicle.offset[1] = 1.5;
  const DriftSettings patient{.baseline_pairs = 120};
  DriftMonitor before(patient);
  vehicle.drive(before, 60);
  REQUIRE(before.verdict() == DriftVerdict::drifted);
  DriftState state = before.state();
  for (int pair = 0; pair < 200; ++pair) {
    DriftMonitor monitor({.baseline_pairs = 50}, std::move(state));
    vehicle.drive(monitor, 1);
    state = monitor.state();
    REQUIRE(monitor.verdict() != DriftVerdict::calibrated);
  }
}

TEST_CASE("less time to notice drift does not withdraw a verdict of it") {
  for (std::uint64_t seed = 0; seed < 10; ++seed) {
    Vehicle vehicle(seed);
    DriftMonitor before({.negligible_rotation_rad = 0});
    vehicle.drive(before, 1500);
    vehicle.offset[0] = 0.35 * Vehicle::noise;
    REQUIRE(pairs_until_drifted(vehicle, before, 3000) < 3000);
    DriftMonitor monitor({.pairs_to_detect = 60, .negligible_rotation_rad = 0}, before.state());
    for (int pair = 0; pair < 30; ++pair) REQUIRE(vehicle.drive(monitor, 1) == DriftVerdict::drifted);
  }
}
