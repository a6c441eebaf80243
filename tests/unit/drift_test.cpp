#include "calib/drift.hpp"

#include <algorithm>
#include <limits>

#include "support/catch.hpp"
#include "support/simulated_drive.hpp"
#include "vehicle/random.hpp"

using namespace calib;
using namespace std::chrono_literals;

namespace {

/// A vehicle whose objective is, for each axis, a hill of curvature 1 (in units of the stencil's step) with its top off
/// the extrinsic by `offset` steps, seen with normal noise of `noise` steps.
class Vehicle {
 public:
  static constexpr double noise = 0.1;
  Vector6 offset = Vector6::Zero();

  explicit Vehicle(std::uint64_t seed) : random_(seed) {}

  Stencil see() {
    Stencil stencil;
    stencil.current = 1.2;
    for (int axis = 0; axis < 6; ++axis) {
      const double top = offset[axis] + noise * random_.gaussian(), curvature = -1 + 0.3 * random_.gaussian();
      stencil.plus[axis] = stencil.current + 0.02 * (top + curvature / 2);
      stencil.minus[axis] = stencil.current + 0.02 * (-top + curvature / 2);
    }
    return stencil;
  }
  DriftVerdict drive(DriftMonitor& monitor, int pairs) {
    for (int i = 0; i < pairs; ++i) monitor.observe(see(), now += 10s);
    return monitor.verdict();
  }

  Timestamp now{};

 private:
  vehicle::Random random_;
};

/// Pairs until the verdict is drifted, at most `most`.
int pairs_until_drifted(Vehicle& vehicle, DriftMonitor& monitor, int most) {
  int pairs = 0;
  while (pairs < most && monitor.verdict() != DriftVerdict::drifted) pairs += (vehicle.drive(monitor, 1), 1);
  return pairs;
}

bool same(const AxisEvidence& a, const AxisEvidence& b) {
  return a.stamp == b.stamp && a.slope == b.slope && a.curvature == b.curvature && a.score == b.score;
}
bool same(const DriftState& a, const DriftState& b) {
  return std::ranges::equal(a.recent, b.recent, [](const auto& x, const auto& y) { return same(x, y); }) &&
         a.baseline.pairs == b.baseline.pairs && a.baseline.slope == b.baseline.slope &&
         a.baseline.slope_squares == b.baseline.slope_squares && a.cusum_up == b.cusum_up &&
         a.cusum_down == b.cusum_down && a.up_since == b.up_since && a.verdict == b.verdict;
}

}  // namespace

TEST_CASE("a LiDAR that stays where it is raises no alarm, whatever the constant bias of the depth source") {
  for (std::uint64_t seed = 0; seed < 100; ++seed) {
    Vehicle vehicle(seed);
    vehicle.offset = Vector6::Constant(seed % 2 == 0 ? 0.2 : -0.2);
    DriftMonitor monitor({});
    for (int pair = 0; pair < 3000; ++pair) REQUIRE(vehicle.drive(monitor, 1) != DriftVerdict::drifted);
    CHECK(monitor.verdict() == DriftVerdict::calibrated);
    CHECK_FALSE(monitor.first_sign());
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
        DriftMonitor monitor({});
        REQUIRE(vehicle.drive(monitor, 100) == DriftVerdict::calibrated);
        vehicle.offset[axis] = 4 * sign * Vehicle::noise;
        const Timestamp moved = vehicle.now;
        delays.push_back(pairs_until_drifted(vehicle, monitor, 50));
        REQUIRE(delays.back() <= 12);
        CHECK(*monitor.first_sign() > moved - 40s);
        CHECK(*monitor.first_sign() <= moved + 20s);
        const auto estimate = *monitor.misalignment();
        CHECK(estimate.delta[axis] / StencilStep{}.of_axis(axis) == Approx(4 * sign * Vehicle::noise).margin(0.2));
        CHECK(estimate.sigma[axis] > 0);
        CHECK_THAT(monitor.reason(), Catch::Matchers::ContainsSubstring(std::string(axis_names[axis])));
        CHECK_THAT(monitor.reason(), Catch::Matchers::ContainsSubstring(sides[axis][sign < 0]));
      }
  std::ranges::sort(delays);
  CHECK(delays[delays.size() / 2] <= 5);
  CHECK(delays[delays.size() * 95 / 100] <= 8);
}

TEST_CASE("a drift that is put right is called calibrated again") {
  Vehicle vehicle(4);
  DriftMonitor monitor({});
  vehicle.drive(monitor, 60);
  vehicle.offset[2] = 1;
  CHECK(vehicle.drive(monitor, 200) == DriftVerdict::drifted);
  vehicle.offset[2] = 0;
  CHECK(vehicle.drive(monitor, 30) == DriftVerdict::calibrated);
}

TEST_CASE("a single bad frame never makes drifted, and does not blind the monitor to what comes after it") {
  vehicle::Random random(8);
  for (int trial = 0; trial < 300; ++trial) {
    Vehicle vehicle(trial);
    DriftMonitor monitor({});
    vehicle.drive(monitor, random.below(60));
    Stencil bad;
    const float size = random.chance(0.5F) ? 1 : 1e6F;
    bad.current = size * random.uniform(-1, 1);
    for (int axis = 0; axis < 6; ++axis) {
      bad.plus[axis] = size * random.uniform(-1, 1);
      bad.minus[axis] = size * random.uniform(-1, 1);
    }
    const bool learning = monitor.verdict() == DriftVerdict::learning;
    REQUIRE(monitor.observe(bad, vehicle.now += 10s) != DriftVerdict::drifted);
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
    CHECK(of_wrong.first_sign() == Timestamp::min());
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

TEST_CASE("nothing is said of an axis of which the scenes tell nothing") {
  DriftMonitor monitor({});
  vehicle::Random random(10);
  for (int pair = 0; pair < 200; ++pair) {
    Stencil flat;
    flat.current = 1.1;
    for (int axis = 0; axis < 6; ++axis) {
      flat.plus[axis] = flat.current + 1e-3 * random.gaussian();
      flat.minus[axis] = flat.current + 1e-3 * random.gaussian();
    }
    REQUIRE(monitor.observe(flat, Timestamp(pair)) != DriftVerdict::drifted);
  }
  REQUIRE(monitor.misalignment());
  for (int axis = 0; axis < 6; ++axis)
    if (!monitor.state().baseline.observable(axis)) {
      CHECK(monitor.misalignment()->delta[axis] == 0);
      CHECK(monitor.misalignment()->sigma[axis] == 2 * StencilStep{}.of_axis(axis));
    }
}

TEST_CASE("before the first pair there is no verdict, no estimate and no sign of drift") {
  const DriftMonitor monitor({});
  CHECK(monitor.verdict() == DriftVerdict::learning);
  CHECK_FALSE(monitor.misalignment());
  CHECK_FALSE(monitor.first_sign());
  CHECK_THAT(monitor.reason(), Catch::Matchers::ContainsSubstring("0 of 20"));
  CHECK(DriftBaseline{}.spread(0) == 0);
  CHECK_FALSE(DriftBaseline{}.observable(0));
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
  const StencilStep step{.rotation_rad = 0.02, .translation_m = 0.3};
  const Stencil stencil = evaluate_stencil(frame, T, step);
  const AxisEvidence evidence = axis_evidence(stencil, 5s, step);
  CHECK(stencil.current == score(frame, T).value);
  CHECK(evidence.score == stencil.current);
  CHECK(evidence.stamp == 5s);
  for (int axis = 0; axis < 6; ++axis) {
    const double h = axis < 3 ? 0.02 : 0.3;
    CHECK(stencil.plus[axis] == score(frame, T * perturbation(Vector6::Unit(axis) * h)).value);
    CHECK(stencil.minus[axis] == score(frame, T * perturbation(Vector6::Unit(axis) * -h)).value);
    // The parabola through the three values goes through them again.
    const double even = stencil.current + evidence.curvature[axis] * h * h / 2, odd = evidence.slope[axis] * h;
    CHECK(even + odd == Approx(stencil.plus[axis]));
    CHECK(even - odd == Approx(stencil.minus[axis]));
    CHECK(stencil.best_neighbour() >= std::max(stencil.plus[axis], stencil.minus[axis]));
  }
  RigidTransform not_a_number = T;
  not_a_number.translation().setConstant(std::numeric_limits<double>::quiet_NaN());
  CHECK(axis_evidence(evaluate_stencil(frame, not_a_number), {}).slope.isZero());
}
