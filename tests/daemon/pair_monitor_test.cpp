#include "pair_monitor.hpp"

#include <cmath>
#include <set>

#include "calib/depth_stereo.hpp"
#include "support/catch.hpp"
#include "support/support.hpp"
#include "vehicle/vehicle.hpp"

using namespace calib;
using namespace std::chrono_literals;

namespace {

/// The simulated vehicle with its stereo camera, and a monitor that learns quickly.
struct Drive {
  explicit Drive(std::uint64_t seed) : vehicle(test::require_ok(vehicle::simulated_vehicle(small(seed)))) {}

  static vehicle::Simulation small(std::uint64_t seed) {
    vehicle::Simulation simulation;
    simulation.seed = seed;
    simulation.width = 480;
    simulation.height = 144;
    simulation.lidar = {.azimuth_step_deg = 0.3, .field_of_view_deg = 110};
    return simulation;
  }

  [[nodiscard]] FramePair pair(int index, const Vector6& knock = Vector6::Zero()) const {
    FramePair pair = test::require_ok(vehicle.frame(index, 4.0 * index, perturbation(knock)));
    pair.image.stamp = pair.right_image->stamp = pair.scan.stamp = 4s * index;
    return pair;
  }
  [[nodiscard]] PairMonitor monitor() const {
    PairMonitorSettings settings;
    settings.frames = 8;
    settings.drift.baseline_pairs = 10;
    return {settings, vehicle.camera, test::require_ok(make_stereo_depth(vehicle.camera, vehicle.baseline_m)),
            vehicle.T_camera_lidar, {}};
  }

  vehicle::Vehicle vehicle;
};

Vector6 yaw(double degrees) { return Vector6::Unit(2) * degrees * radians_per_degree; }

std::string refusal(PairMonitor& monitor, const FramePair& pair) {
  const auto evidence = monitor.evaluate(pair);
  return evidence ? "" : word(evidence.error().code);
}

}  // namespace

TEST_CASE("a knock is found and recalibrated from pairs taken since, and what is adopted starts anew") {
  const Drive drive(71);
  PairMonitor monitor = drive.monitor();
  CHECK(monitor.wanted_pairs() == 10);
  CHECK(monitor.recalibrate().error().code == "not_ready");
  for (int i = 0; i < 14; ++i) {
    CHECK(monitor.can_recalibrate() == (i >= 10));
    auto evidence = test::require_ok(monitor.measure(drive.pair(i)));
    CHECK(evidence.stencil.current > 1);
    CHECK(evidence.response.has_value());
    const double scored = evidence.stencil.current;
    const DriftVerdict verdict = monitor.observe(std::move(evidence));
    CHECK(verdict == monitor.drift().verdict());
    CHECK(monitor.score_of_latest(monitor.T_camera_lidar()) == scored);
    CHECK(monitor.score_of_latest(monitor.T_camera_lidar() * perturbation(yaw(2))) < scored);
  }
  REQUIRE(monitor.drift().verdict() == DriftVerdict::calibrated);
  CHECK(monitor.progress() == "10 of 10");

  int last = 14;
  for (; last < 50 && !(monitor.drift().verdict() == DriftVerdict::drifted && monitor.can_recalibrate()); ++last)
    REQUIRE(monitor.evaluate(drive.pair(last, yaw(-1))));
  REQUIRE(monitor.drift().verdict() == DriftVerdict::drifted);
  CHECK(last <= 26);
  const auto outcome = test::require_ok(monitor.recalibrate());
  INFO(outcome.result.reason);
  CHECK(outcome.result.accepted);
  CHECK(outcome.result.delta[2] == Approx(-radians_per_degree).margin(0.35 * radians_per_degree));
  CHECK(std::set(outcome.frames.begin(), outcome.frames.end()).size() == monitor.wanted_pairs());
  CHECK(outcome.frames.front() >= *monitor.drift().first_sign());
  CHECK(outcome.frames.front() >= 4s * 13);  // none, or hardly any, of before the knock

  monitor.adopt(outcome.result.T_camera_lidar);
  CHECK(monitor.T_camera_lidar().matrix() == outcome.result.T_camera_lidar.matrix());
  CHECK(monitor.drift().verdict() == DriftVerdict::learning);
  CHECK(monitor.drift().state().recent.empty());
  CHECK(monitor.progress() == "0 of 10");
  for (int i = 0; i < 11; ++i) REQUIRE(monitor.evaluate(drive.pair(last + i, yaw(-1))));
  CHECK(monitor.drift().verdict() == DriftVerdict::calibrated);
}

TEST_CASE("a pair that says nothing is refused by name and leaves the monitor as it was") {
  const Drive drive(72);
  PairMonitor monitor = drive.monitor();
  const FramePair good = drive.pair(0);
  REQUIRE(monitor.evaluate(good));
  const auto damaged = [&](auto damage) {
    FramePair pair = drive.pair(1);
    damage(pair);
    return refusal(monitor, pair);
  };
  CHECK(refusal(monitor, good) == "standing_still");
  CHECK(damaged([](FramePair& pair) { pair.image.pixels.assign(pair.image.pixels.size(), 5); }) == "dark");
  CHECK(damaged([](FramePair& pair) { pair.image.pixels.assign(pair.image.pixels.size(), 255); }) == "saturated");
  CHECK(damaged([](FramePair& pair) { pair.image = {}; }) == "image_size_mismatch");
  CHECK(damaged([](FramePair& pair) { pair.scan.points.clear(); }) == "low_overlap");
  CHECK(damaged([](FramePair& pair) { for (LidarPoint& p : pair.scan.points) p.x_m = -std::abs(p.x_m) - 5; }) ==
        "low_overlap");
  CHECK(damaged([](FramePair& pair) { pair.right_image.reset(); }) == "depth_failed");
  CHECK(damaged([](FramePair& pair) { pair.right_image->pixels.assign(pair.right_image->pixels.size(), 90); }) ==
        "few_valid_depth");
  CHECK(monitor.progress() == "1 of 10");
  CHECK(monitor.drift().state().recent.size() == 1);
  // A refused pair is no reason to call the next one standing still.
  CHECK(refusal(monitor, drive.pair(1)).empty());
}

TEST_CASE("pairs that are forgotten have to be gathered again, and the verdict stays") {
  const Drive drive(73);
  PairMonitor monitor = drive.monitor();
  for (int i = 0; i < 12; ++i) REQUIRE(monitor.evaluate(drive.pair(i)));
  REQUIRE(monitor.can_recalibrate());
  const DriftVerdict before = monitor.drift().verdict();
  monitor.forget_pairs();
  CHECK(monitor.progress() == "0 of 10");
  CHECK_FALSE(monitor.can_recalibrate());
  CHECK(monitor.drift().verdict() == before);
}

TEST_CASE("without a sign of drift a recalibration is no more than a look, and the extrinsic in force stays") {
  const Drive drive(74);
  PairMonitor monitor = drive.monitor();
  for (int i = 0; i < 12; ++i) REQUIRE(monitor.evaluate(drive.pair(i)));
  const auto outcome = test::require_ok(monitor.recalibrate());
  CHECK_FALSE(outcome.result.accepted);
  CHECK(monitor.T_camera_lidar().matrix() == drive.vehicle.T_camera_lidar.matrix());
}
