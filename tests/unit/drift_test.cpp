#include "calib/drift.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "support/catch.hpp"
#include "support/simulated_drive.hpp"
#include "unit/drift_vehicle.hpp"

using namespace calib;
using namespace std::chrono_literals;
using test::keen;
using test::pairs_until_drifted;
using test::Vehicle;

namespace {

bool same(const DriftState& a, const DriftState& b) {
  const auto same_seen = [](const auto& x, const auto& y) { return x.stamp == y.stamp && x.slope == y.slope; };
  return std::ranges::equal(a.recent, b.recent, same_seen) && a.charts == b.charts && a.loss_charts == b.loss_charts &&
         a.unlearned == b.unlearned && a.repeats == b.repeats && a.baseline.pairs == b.baseline.pairs &&
         a.baseline.slope == b.baseline.slope && a.baseline.slope_products == b.baseline.slope_products &&
         a.baseline.sensitivity == b.baseline.sensitivity && a.verdict == b.verdict;
}

}  // namespace

TEST_CASE("a LiDAR that stays where it is raises no alarm, whatever the bias of the depth source", "[release-only]") {
  for (std::uint64_t seed = 0; seed < 100; ++seed) {
    Vehicle vehicle(seed);
    vehicle.offset = Vector6::Constant(seed % 2 == 0 ? 0.2 : -0.2);
    DriftMonitor monitor({});
    for (int pair = 0; pair < 3000; ++pair) REQUIRE(vehicle.drive(monitor, 1) != DriftVerdict::drifted);
    CHECK(monitor.verdict() == DriftVerdict::calibrated);
    CHECK_FALSE(monitor.onset());
    REQUIRE(monitor.misalignment());
    CHECK((monitor.misalignment()->delta.head<3>() / StencilStep{}.rotation_rad).cwiseAbs().maxCoeff() < 0.3);
  }
}

TEST_CASE("a shift of four deviations is soon found, with its axis, its side and its beginning") {
  std::vector<int> delays;
  const char* const sides[6][2] = {{"right side down", "left side down"}, {"nose down", "nose up"},
                                   {"to the left", "to the right"},       {"forward", "back"},
                                   {"to the left", "to the right"},       {"up", "down"}};
  for (int axis = 0; axis < 6; ++axis)
    for (const double sign : {1.0, -1.0})
      for (std::uint64_t seed = 0; seed < 20; ++seed) {
        Vehicle vehicle(seed);
        DriftMonitor monitor(keen);
        REQUIRE(vehicle.drive(monitor, 100) == DriftVerdict::calibrated);
        vehicle.offset[axis] = 4 * sign * Vehicle::noise;
        const Timestamp moved = vehicle.now;
        delays.push_back(pairs_until_drifted(vehicle, monitor, 50));
        REQUIRE(delays.back() <= 14);
        CHECK(*monitor.onset() > moved - 40s);
        CHECK(*monitor.onset() <= moved + 80s);
        const auto estimate = *monitor.misalignment();
        CHECK(estimate.delta[axis] / StencilStep{}.of_axis(axis) == Approx(4 * sign * Vehicle::noise).margin(0.25));
        CHECK(estimate.sigma()[axis] > 0);
        CHECK_THAT(monitor.reason(), Catch::Matchers::ContainsSubstring(std::string(axis_names[axis])));
        CHECK_THAT(monitor.reason(), Catch::Matchers::ContainsSubstring(sides[axis][sign < 0]));
      }
  std::ranges::sort(delays);
  CHECK(delays[delays.size() / 2] <= 6);
  CHECK(delays[delays.size() * 95 / 100] <= 9);
}

TEST_CASE("a drift that is put right is called calibrated again") {
  Vehicle vehicle(4);
  DriftMonitor monitor(keen);
  vehicle.drive(monitor, 60);
  vehicle.offset[2] = 1;
  CHECK(vehicle.drive(monitor, 200) == DriftVerdict::drifted);
  vehicle.offset[2] = 0;
  CHECK(vehicle.drive(monitor, 50) == DriftVerdict::calibrated);
}

TEST_CASE("small shifts are detected within many pairs, and slow ones as well as sudden ones") {
  for (const double slope : {0.0, 0.01})  // steps per pair
    for (std::uint64_t seed = 0; seed < 40; ++seed) {
      Vehicle vehicle(seed);
      DriftMonitor monitor(keen);
      vehicle.drive(monitor, 100);
      if (slope == 0) vehicle.offset[1] = 2 * Vehicle::noise;
      int pairs = 0;
      for (; pairs < 60 && monitor.verdict() != DriftVerdict::drifted; ++pairs) {
        vehicle.offset[1] += slope;
        vehicle.drive(monitor, 1);
      }
      REQUIRE(monitor.verdict() == DriftVerdict::drifted);
    }
}

TEST_CASE("a shift right after the baseline was learned does not enter the baseline") {
  for (std::uint64_t seed = 0; seed < 100; ++seed) {
    Vehicle vehicle(seed);
    DriftMonitor monitor(keen);
    vehicle.drive(monitor, monitor.settings().baseline_pairs);
    vehicle.offset[seed % 6] = 4 * Vehicle::noise;
    REQUIRE(pairs_until_drifted(vehicle, monitor, 40) < 40);
    vehicle.drive(monitor, 200);
    REQUIRE(monitor.verdict() == DriftVerdict::drifted);
  }
}

TEST_CASE("chance raises no more alarms than are wanted, also where consecutive pairs err alike", "[release-only]") {
  DriftSettings settings = keen;
  settings.false_alarms_per_pair = 1e-2;
  constexpr int vehicles = 10, pairs = 10'000;
  for (const double correlation : {0.0, 0.2}) {
    int alarms = 0;
    for (std::uint64_t seed = 0; seed < vehicles; ++seed) {
      Vehicle vehicle(seed);
      vehicle.correlation = correlation;
      DriftMonitor monitor(settings);
      for (int pair = 0; pair < pairs; ++pair)
        if (vehicle.drive(monitor, 1) == DriftVerdict::drifted) {
          ++alarms;
          monitor.restart();
        }
    }
    CAPTURE(correlation, alarms);
    CHECK(alarms <= vehicles * pairs * settings.false_alarms_per_pair);
    CHECK(alarms > 0);
  }
}

TEST_CASE("a pair of the baseline without a response is refused and changes nothing") {
  Vehicle vehicle(5);
  DriftMonitor monitor({});
  vehicle.drive(monitor, 3);
  AxisEvidence evidence = vehicle.see();
  evidence.sensitivity.reset();
  const DriftState before = monitor.state();
  const auto refused = monitor.observe(evidence);
  REQUIRE_FALSE(refused);
  CHECK(refused.error().code == "sensitivity_missing");
  CHECK(same(monitor.state(), before));

  vehicle.drive(monitor, 30);  // there is a baseline, to which such a pair adds nothing
  REQUIRE(monitor.learned());
  CHECK(monitor.observe(evidence));
}

TEST_CASE("the drift monitor ignores a single outlier, which does not mask a later drift") {
  vehicle::Random random(8);
  for (int trial = 0; trial < 300; ++trial) {
    Vehicle vehicle(trial);
    DriftMonitor monitor({});
    vehicle.drive(monitor, random.below(60));
    AxisEvidence bad = vehicle.see();
    const float size = random.chance(0.5F) ? 1 : 1e6F;
    for (int axis = 0; axis < 6; ++axis) bad.slope[axis] = size * random.uniform(-1, 1);
    const bool learning = !monitor.learned();
    REQUIRE(monitor.observe(bad) != DriftVerdict::drifted);
    for (int pair = 0; pair < 40; ++pair) REQUIRE(vehicle.drive(monitor, 1) != DriftVerdict::drifted);
    if (learning) continue;  // then it widens the baseline: the careful side
    vehicle.offset[1] = -8 * Vehicle::noise;
    REQUIRE(pairs_until_drifted(vehicle, monitor, 50) <= 10);
  }
}

TEST_CASE("an extrinsic that is wrong from the start is found while learning, a biased depth source is not") {
  for (std::uint64_t seed = 0; seed < 50; ++seed) {
    Vehicle wrong(seed), biased(seed);
    wrong.offset[seed % 6] = seed % 2 == 0 ? 1.9 : -1.9;   // 1.4 degrees or 28 cm
    biased.offset[seed % 6] = seed % 2 == 0 ? 0.4 : -0.4;  // 0.3 degrees or 6 cm
    DriftMonitor of_wrong({}), of_biased({});
    CHECK(pairs_until_drifted(wrong, of_wrong, 50) < DriftSettings{}.baseline_pairs);
    // However long it stays so: no pair was taken before it was wrong.
    CHECK(wrong.drive(of_wrong, 60) == DriftVerdict::drifted);
    CHECK(of_wrong.onset() == Timestamp::min());
    CHECK_FALSE(of_wrong.misalignment());
    CHECK(biased.drive(of_biased, 60) == DriftVerdict::calibrated);
  }
}

TEST_CASE("translation is not judged from the start where depth may shift it by any amount, and rotation still is") {
  const DriftSettings guessed{.max_bias_translation_m = std::numeric_limits<double>::infinity()};
  for (int axis = 0; axis < 6; ++axis) {
    Vehicle vehicle(static_cast<std::uint64_t>(axis));
    vehicle.offset[axis] = 1.9;
    DriftMonitor monitor(guessed);
    CHECK(vehicle.drive(monitor, 60) == (axis < 3 ? DriftVerdict::drifted : DriftVerdict::calibrated));
  }
}

TEST_CASE("a restart forgets everything") {
  Vehicle vehicle(9);
  DriftMonitor monitor({}), fresh({});
  vehicle.drive(monitor, 60);
  vehicle.offset.setConstant(2);
  REQUIRE(vehicle.drive(monitor, 20) == DriftVerdict::drifted);
  monitor.restart();
  CHECK(monitor.verdict() == DriftVerdict::learning);
  CHECK(same(monitor.state(), fresh.state()));
  vehicle.offset.setZero();
  Vehicle again = vehicle;
  vehicle.drive(monitor, 70);
  again.drive(fresh, 70);
  CHECK(same(monitor.state(), fresh.state()));
  CHECK(monitor.reason() == fresh.reason());
}

TEST_CASE("a monitor that could not notice a rotation says so and calls nothing calibrated") {
  vehicle::Random random(10);
  for (int axis_of_noise = 0; axis_of_noise < 6; ++axis_of_noise) {
    Vehicle vehicle(static_cast<std::uint64_t>(axis_of_noise));
    DriftMonitor monitor({});
    for (int pair = 0; pair < 150; ++pair) {
      AxisEvidence evidence = vehicle.see();
      (*evidence.sensitivity)(axis_of_noise, axis_of_noise) *= 0.1 * random.gaussian();
      REQUIRE(monitor.observe(evidence) != DriftVerdict::drifted);
      if (axis_of_noise < 3) REQUIRE(monitor.verdict() != DriftVerdict::calibrated);
    }
    CHECK(monitor.verdict() == (axis_of_noise < 3 ? DriftVerdict::insufficient_power : DriftVerdict::calibrated));
    for (int axis = 0; axis < 6; ++axis) CHECK(std::isfinite(monitor.detection_limit(axis)) == (axis != axis_of_noise));
    CHECK(monitor.misalignment()->delta[axis_of_noise] == 0);
    CHECK(monitor.misalignment()->sigma()[axis_of_noise] == Approx(StencilStep{}.of_axis(axis_of_noise)));
    if (axis_of_noise < 3)
      CHECK_THAT(monitor.reason(), Catch::Matchers::ContainsSubstring(std::string(axis_names[axis_of_noise])) &&
                                       Catch::Matchers::ContainsSubstring("could go unnoticed"));
    vehicle.offset[(axis_of_noise + 1) % 6] = 1;
    CHECK(vehicle.drive(monitor, 20) == DriftVerdict::drifted);  // what is observable is still detected
  }
}

TEST_CASE("a displacement beyond the basin is detected by the loss of the maximum; scenes of less prominence are not") {
  for (std::uint64_t seed = 0; seed < 40; ++seed) {
    Vehicle vehicle(seed);
    DriftMonitor monitor({});
    vehicle.drive(monitor, 60);
    vehicle.prominence *= 0.7;
    REQUIRE(vehicle.drive(monitor, 500) == DriftVerdict::calibrated);
    vehicle.prominence = 0;
    REQUIRE(pairs_until_drifted(vehicle, monitor, 50) <= 30);
    CHECK_THAT(monitor.reason(), Catch::Matchers::ContainsSubstring("too far to estimate where to"));
    CHECK(monitor.misalignment()->sigma()[3] == Approx(2 * StencilStep{}.translation_m));
  }
}

TEST_CASE("an extrinsic that is not the best of its neighbours is never called calibrated") {
  Vehicle vehicle(13);
  vehicle.prominence = 0;
  DriftMonitor monitor({});
  for (int pair = 0; pair < 200; ++pair) {
    vehicle.drive(monitor, 1);
    REQUIRE(monitor.verdict() != DriftVerdict::calibrated);
  }
  CHECK(monitor.verdict() == DriftVerdict::insufficient_power);
  CHECK_THAT(monitor.reason(), Catch::Matchers::ContainsSubstring("even a large displacement could go unnoticed"));
}

TEST_CASE("the noise of the evidence decides which shift would be noticed") {
  Vehicle vehicle(11);
  DriftMonitor monitor({});
  CHECK((std::isinf(monitor.detection_limit(0)) && std::isinf(monitor.pairs_to_notice())));
  vehicle.drive(monitor, 100);
  for (int axis = 0; axis < 6; ++axis) {
    const double shift = monitor.detection_limit(axis) / StencilStep{}.of_axis(axis);
    CHECK(shift > 0.3 * Vehicle::noise);
    CHECK(shift < 2.5 * Vehicle::noise);
    DriftMonitor of_it = monitor;
    Vehicle moved = vehicle;
    moved.offset[axis] = shift;
    CHECK(pairs_until_drifted(moved, of_it, 1000) < 1000);
  }
}

TEST_CASE("a rotation that must be noticed takes about as many pairs as foretold, whatever its size and the noise") {
  for (const double steps : {0.2, 0.3, 0.5, 1.0}) {
    double foretold = 0, taken = 0;
    for (std::uint64_t seed = 0; seed < 40; ++seed) {
      Vehicle vehicle(seed);
      DriftMonitor monitor({.must_detect_rotation_rad = steps * StencilStep{}.rotation_rad});
      vehicle.drive(monitor, 200);
      foretold += monitor.pairs_to_notice();
      vehicle.offset[1] = seed % 2 == 0 ? steps : -steps;
      taken += pairs_until_drifted(vehicle, monitor, 2000);
    }
    INFO(steps << " steps: foretold " << foretold / 40 << ", taken " << taken / 40);
    CHECK((taken < 1.1 * foretold && taken > 0.4 * foretold));
  }
}

TEST_CASE("while the baseline is learned, the reason says how far the best extrinsic may be") {
  Vehicle vehicle(14);
  DriftMonitor monitor({});
  vehicle.drive(monitor, 5);
  CHECK(monitor.reason() == "learning the baseline: 5 of 20 scenes");
  vehicle.drive(monitor, 10);
  CHECK_THAT(monitor.reason(), Catch::Matchers::Matches(".*15 of 20 .* is within 0\\.[1-3] degrees .*"));
}

TEST_CASE("a shift along one axis that changes the slopes of two is attributed to that axis") {
  for (const auto& [moved, other] : {std::pair{2, 4}, std::pair{4, 2}}) {
    Vehicle vehicle(12);
    DriftMonitor monitor({});
    const auto drive = [&](int pairs) {
      for (int pair = 0; pair < pairs; ++pair) {
        // y shows in yaw, and yaw in y.
        AxisEvidence evidence = vehicle.see();
        evidence.slope[2] += 0.6 * 0.02 / StencilStep{}.of_axis(2) * vehicle.offset[4];
        evidence.slope[4] += 0.6 * 0.02 / StencilStep{}.of_axis(4) * vehicle.offset[2];
        const double coupling = 0.6 * 0.02 / StencilStep{}.of_axis(2) / StencilStep{}.of_axis(4);
        (*evidence.sensitivity)(2, 4) = (*evidence.sensitivity)(4, 2) = coupling;
        monitor.observe(evidence);
      }
    };
    drive(100);
    vehicle.offset[moved] = 0.6;
    drive(15);
    REQUIRE(monitor.verdict() == DriftVerdict::drifted);
    const auto estimate = *monitor.misalignment();
    CHECK(estimate.delta[moved] / StencilStep{}.of_axis(moved) == Approx(0.6).margin(0.12));
    CHECK(std::abs(estimate.delta[other] / StencilStep{}.of_axis(other)) < 0.12);
  }
}

TEST_CASE("before the first pair there is no verdict, no estimate and no sign of drift") {
  const DriftMonitor monitor({});
  CHECK(monitor.verdict() == DriftVerdict::learning);
  CHECK_FALSE(monitor.misalignment());
  CHECK_FALSE(monitor.onset());
  CHECK_THAT(monitor.reason(), Catch::Matchers::ContainsSubstring("0 of 20"));
  CHECK(DriftBaseline{}.spread(0) == 0);
  CHECK(monitor.wants_sensitivity());
}

TEST_CASE("on frames of a street the evidence leans to the side to which the LiDAR was knocked") {
  test::SimulatedDrive drive(51);
  constexpr int frames = 5;
  const auto slopes = [&](const RigidTransform& motion) {
    Vector6 sum = Vector6::Zero();
    for (int i = 0; i < frames; ++i)
      sum += axis_evidence(evaluate_stencil(drive.features(i, motion), drive.T_camera_lidar()), {}).slope;
    return sum;
  };
  const std::array<double, 6> size{1, 0.4, 0.4, 0.3, 0.15, 0.15};
  for (int axis = 0; axis < 6; ++axis) {
    const double delta = size[axis] * (axis < 3 ? radians_per_degree : 1);
    const double to_plus = slopes(perturbation(Vector6::Unit(axis) * delta))[axis];
    const double to_minus = slopes(perturbation(Vector6::Unit(axis) * -delta))[axis];
    INFO(axis_names[axis]);
    CHECK(to_plus > 0);
    CHECK(to_minus < 0);
  }
}

TEST_CASE("a stencil is the score at the extrinsic and at its twelve neighbours, and evidence their differences") {
  test::SimulatedDrive drive(52);
  const FeatureSet frame = drive.features(0);
  const RigidTransform& T = drive.T_camera_lidar();
  const StencilStep steps[] = {{.rotation_rad = 0.02, .translation_m = 0.3},
                               {.rotation_rad = 0.01, .translation_m = 0.1}};
  const Stencil stencil = evaluate_stencil(frame, T, steps);
  const AxisEvidence evidence = axis_evidence(stencil, 5s);
  CHECK(stencil.current == score(frame, T).value);
  CHECK(evidence.score == stencil.current);
  CHECK(evidence.stamp == 5s);
  Vector6 slope = Vector6::Zero();
  double neighbours = 0;
  REQUIRE(stencil.widths.size() == 2);
  for (std::size_t i = 0; i < 2; ++i)
    for (int axis = 0; axis < 6; ++axis) {
      const double h = axis < 3 ? steps[i].rotation_rad : steps[i].translation_m;
      const auto& [step, minus, plus] = stencil.widths[i];
      CHECK(plus[axis] == score(frame, T * perturbation(Vector6::Unit(axis) * h)).value);
      CHECK(minus[axis] == score(frame, T * perturbation(Vector6::Unit(axis) * -h)).value);
      CHECK(stencil.best_neighbour() >= std::max(plus[axis], minus[axis]));
      slope[axis] += (plus[axis] - minus[axis]) / (2 * h) / 2;
      neighbours += (plus[axis] + minus[axis]) / 24;
    }
  CHECK(evidence.slope.isApprox(slope));
  CHECK(evidence.prominence == Approx(stencil.current - neighbours));
  const RigidTransform nowhere = T * Eigen::Translation3d(std::numeric_limits<double>::quiet_NaN(), 0, 0);
  CHECK(axis_evidence(evaluate_stencil(frame, nowhere), {}).slope.isZero());
}

TEST_CASE("the response foretells what the slopes become when the LiDAR moves") {
  test::SimulatedDrive drive(53);
  constexpr int frames = 6;
  for (int axis = 0; axis < 6; ++axis) {
    const double shift = axis < 3 ? 0.25 * radians_per_degree : 0.1;
    Vector6 before = Vector6::Zero(), after = before, foretold = before;
    for (int i = 0; i < frames; ++i) {
      const FeatureSet frame = drive.features(i);
      const RigidTransform& T = drive.T_camera_lidar();
      before += axis_evidence(evaluate_stencil(frame, T), {}).slope;
      foretold += evaluate_sensitivity(frame, T).col(axis) * shift;
      const FeatureSet moved = drive.features(i, perturbation(Vector6::Unit(axis) * shift));
      after += axis_evidence(evaluate_stencil(moved, T), {}).slope;
    }
    INFO(axis_names[axis]);
    CHECK(foretold[axis] > 0);
    CHECK((after - before)[axis] == Approx(foretold[axis]).epsilon(0.4));
  }
}
