#include "calib/recalibrate.hpp"

#include <algorithm>
#include <limits>

#include "calib/drift.hpp"
#include "scenario/adversities.hpp"
#include "support/catch.hpp"

using namespace calib;

namespace {

constexpr int fitted = 8, held = 4;

/// Pairs of a LiDAR that was knocked by `motion`: those to fit, and those held back.
struct Drive {
  explicit Drive(const RigidTransform& motion, std::uint64_t seed = 61, int count = fitted + held) : simulated(seed) {
    start = simulated.T_camera_lidar();
    frames = simulated.features_of(count, motion);
    if (count > 0) share_out(fitted);
  }
  void share_out(int to_fit) {
    const auto all = test::pointers(frames);
    fit.assign(all.begin(), all.begin() + to_fit);
    held_back.assign(all.begin() + to_fit, all.end());
  }
  [[nodiscard]] Recalibration search(const RecalibrationSettings& settings = {}) const {
    return test::require_ok(recalibrate(fit, held_back, start, settings));
  }

  test::SimulatedDrive simulated;
  RigidTransform start;
  std::vector<FeatureSet> frames;
  std::vector<const FeatureSet*> fit, held_back;
};

bool translated(const Recalibration& result) { return result.moved[3] || result.moved[4] || result.moved[5]; }

bool same(const Recalibration& a, const Recalibration& b) {
  return a.accepted == b.accepted && a.reason == b.reason && a.T_camera_lidar.matrix() == b.T_camera_lidar.matrix() &&
         a.delta == b.delta && a.sigma == b.sigma && a.score_after == b.score_after && a.evaluations == b.evaluations;
}

}  // namespace

TEST_CASE("a LiDAR that was knocked about any axis is found again, and the result says how far it went") {
  const RigidTransform motion =
      GENERATE(test::knock(1, 0, 0), test::knock(0, -1, 0), test::knock(0, 0, 1), test::knock(-1, 1, -1, 0, 0.1, -0.1));
  const Drive drive(motion);
  const Recalibration result = drive.search();
  INFO(result.reason);
  const RigidTransform error = (drive.simulated.T_camera_lidar() * motion).inverse() * result.T_camera_lidar;
  CHECK(result.accepted);
  CHECK(rotation_angle_rad(error) < 0.25 * radians_per_degree);
  CHECK(error.translation().norm() < 0.2);
  CHECK((result.delta - perturbation_parameters(drive.simulated.T_camera_lidar().inverse() * result.T_camera_lidar))
            .isZero(1e-12));
  CHECK(result.score_after > result.score_before);
  CHECK(result.held_back_after > result.held_back_before);
  CHECK(result.sigma.minCoeff() > 0);
  CHECK(result.sigma.head<3>().maxCoeff() < (translated(result) ? 1 : 0.1) * radians_per_degree);
  CHECK((translated(result) || result.delta.tail<3>().isZero(1e-9)));
  CHECK((!translated(result) || !motion.translation().isZero()));  // what has only been turned is not shifted
}

TEST_CASE("from its own result there is nowhere to go, and without a sign of drift nothing is accepted") {
  const Drive drive(test::knock(0, 0.8, -0.6));
  const Recalibration first = drive.search();
  REQUIRE(first.accepted);
  const Recalibration second =
      test::require_ok(recalibrate(drive.fit, drive.held_back, first.T_camera_lidar,
                                   {.bounds = {},
                                    .min_change_rotation_rad = DriftSettings{}.max_bias_rotation_rad,
                                    .min_change_translation_m = DriftSettings{}.max_bias_translation_m}));
  CHECK_FALSE(second.accepted);
  CHECK(second.delta.head<3>().norm() < 0.1 * radians_per_degree);
  CHECK(second.delta.tail<3>().norm() < 0.1);
  CHECK(second.score_after >= second.score_before - 1e-4);
  CHECK_THAT(second.reason, Catch::Matchers::ContainsSubstring("bias"));
  CHECK_THAT(second.reason, Catch::Matchers::ContainsSubstring("; also not better on pairs held back"));
}

TEST_CASE("nothing leaves the bounds, and what ends at one is refused") {
  const Drive drive(test::knock(0, 0, 3));
  const SearchBounds bounds{.rotation_rad = radians_per_degree, .translation_m = 0.1};
  const Recalibration result = drive.search({.bounds = bounds});
  CHECK_FALSE(result.accepted);
  CHECK_THAT(result.reason, Catch::Matchers::ContainsSubstring("outside the bounds") &&
                                Catch::Matchers::ContainsSubstring("ends at the limit of"));
  for (int axis = 0; axis < 6; ++axis)
    CHECK(std::abs(result.delta[axis]) <= 1.02 * (axis < 3 ? bounds.rotation_rad : bounds.translation_m));
}

TEST_CASE("with monocular depth the translation does not change, and the rotation is found all the same") {
  const Drive drive(test::knock(0, 0, 1, 0.2, 0.2, 0));
  const Recalibration result = drive.search({.bounds = {}, .monocular_depth = true});
  CHECK_FALSE(translated(result));
  CHECK(result.delta.tail<3>().norm() < 1e-12);
  CHECK(result.delta.head<3>().norm() > 0.3 * radians_per_degree);
  CHECK(result.accepted);
}

TEST_CASE("what fits the pairs to fit but not those held back is refused") {
  const Drive knocked(test::knock(0, 0, 1)), right(RigidTransform::Identity(), 62);
  const Recalibration result =
      test::require_ok(recalibrate(knocked.fit, right.held_back, knocked.simulated.T_camera_lidar(), {}));
  CHECK(result.score_after > result.score_before);
  CHECK(result.held_back_after < result.held_back_before);
  CHECK_FALSE(result.accepted);
  CHECK_THAT(result.reason, Catch::Matchers::ContainsSubstring("not better"));
}

TEST_CASE("the same pairs give the same result to the last bit, and the order of those held back decides nothing") {
  Drive drive(test::knock(0.4, 0.4, 0.4));
  drive.fit.resize(4);
  const Recalibration once = drive.search();
  CHECK(same(drive.search(), once));
  std::ranges::reverse(drive.held_back);
  const Recalibration reversed = drive.search();
  CHECK(reversed.accepted == once.accepted);
  CHECK(reversed.T_camera_lidar.matrix() == once.T_camera_lidar.matrix());
  CHECK(reversed.sigma == once.sigma);
  CHECK(reversed.reason == once.reason);
}

TEST_CASE("too few pairs are refused, and an extrinsic that is no number is never accepted") {
  const Drive drive(test::knock(0, 0, 1));
  const RigidTransform& T = drive.simulated.T_camera_lidar();
  const auto code = [&](std::size_t fit, std::size_t held_back) {
    const auto result = recalibrate(Frames(drive.fit).first(fit), Frames(drive.held_back).first(held_back), T, {});
    return result ? "" : word(result.error().code);
  };
  CHECK(code(0, 0) == "too_few_pairs");
  CHECK(code(2, 4) == "too_few_pairs");
  CHECK(code(8, 1) == "too_few_pairs");
  CHECK(code(3, 2).empty());
  RigidTransform not_a_number = T;
  not_a_number.translation().setConstant(std::numeric_limits<double>::quiet_NaN());
  const auto result = recalibrate(drive.fit, drive.held_back, not_a_number, {});
  CHECK_FALSE((result && result->accepted));
}

namespace {

/// Pairs as the adversity leaves them, of a LiDAR that moved by `motion(index)`.
template <typename Motion>
Drive spoilt_drive(Motion motion, void (*spoil)(test::Sample&), int count = fitted + held) {
  Drive drive(RigidTransform::Identity(), 63, 0);
  static const test::AdversePlace street(test::PlaceKind::street, 63, 2 * (fitted + held));
  drive.frames.reserve(count);
  for (int i = 0; i < count; ++i) {
    test::Sample sample = test::sound_sample(street, i, motion(i));
    spoil(sample);
    drive.frames.push_back(
        test::require_ok(make_features(sample.pair, sample.depth, street.rig().camera, street.rig().T_camera_lidar)));
  }
  drive.share_out(count - held);
  return drive;
}
void leave_alone(test::Sample&) {}
/// Of a camera that looks elsewhere, with reflectance that says little.
void turn_depth(test::Sample& sample) {
  test::adverse::shift_depth(sample.depth, 5, 0);
  vehicle::Random random(1);
  for (LidarPoint& point : sample.pair.scan.points)
    if (random.chance(0.6F)) point.reflectance = random.uniform(0, 1);
}
void turn_depth_without_reflectance(test::Sample& sample) {
  turn_depth(sample);
  test::adverse::set_reflectance(sample.pair.scan, nullptr);
}
void bias_depth(test::Sample& sample) { add_smooth_bias(sample.depth, 0.4, 3); }

Expectation expected_yaw(double degrees) {
  Expectation expected{.delta = Vector6::Unit(2) * degrees * radians_per_degree};
  for (int axis = 0; axis < 6; ++axis) {
    expected.covariance(axis, axis) = std::pow(axis < 3 ? 0.05 * radians_per_degree : 0.05, 2);
    expected.reach[axis] = axis < 3 ? 1.4 * radians_per_degree : 0.28;
  }
  return expected;
}

}  // namespace

TEST_CASE("what contradicts the evidence of drift is refused, and beyond its reach only the side counts") {
  const Drive slight(test::knock(0, 0, 1)), far(test::knock(0, 0, 2.5));
  const auto given = [](const Drive& drive, double expected_deg) {
    return drive.search({.bounds = {}, .expected = expected_yaw(expected_deg)});
  };
  CHECK(given(slight, 0.9).accepted);
  CHECK(given(far, 1.45).accepted);
  for (const Recalibration& result : {given(slight, -0.8), given(slight, -1.45), given(far, -1.45)}) {
    CHECK_FALSE(result.accepted);
    CHECK_THAT(result.reason, Catch::Matchers::StartsWith("contradicts the evidence of drift") &&
                                  Catch::Matchers::ContainsSubstring("yaw"));
  }
}

TEST_CASE("a rotated depth map does not move the extrinsic where reflectance contradicts it") {
  const auto nowhere = [](int) { return RigidTransform::Identity(); };
  const Recalibration with_reflectance = spoilt_drive(nowhere, turn_depth).search();
  INFO(with_reflectance.delta.transpose() << with_reflectance.reason);
  CHECK_FALSE(with_reflectance.accepted);
  CHECK_THAT(with_reflectance.reason, Catch::Matchers::ContainsSubstring("intensity contradicts"));
  const Recalibration without_reflectance = spoilt_drive(nowhere, turn_depth_without_reflectance).search();
  INFO(without_reflectance.reason);
  CHECK(without_reflectance.accepted);  // nothing else in the pairs contradicts it
}

TEST_CASE("correcting a displaced LiDAR restores the baseline score; a failed depth source does not") {
  const auto moved = [](int) { return test::knock(0, 0.5, -1); };
  const Drive before = spoilt_drive([](int) { return RigidTransform::Identity(); }, leave_alone),
              knocked = spoilt_drive(moved, leave_alone), gone_wrong = spoilt_drive(moved, bias_depth);
  BaselineScore normal{.objective = depth_objective, .mean = 0, .deviation = 0.01, .pairs = fitted + held};
  normal.mean = mean_score(test::pointers(before.frames), before.start, depth_objective).value;
  const Recalibration right = knocked.search({.bounds = {}, .baseline_score = normal});
  INFO(right.reason);
  CHECK(right.accepted);
  const Recalibration wrong = gone_wrong.search({.bounds = {}, .baseline_score = normal});
  CHECK_FALSE(wrong.accepted);
  CHECK_THAT(wrong.reason, Catch::Matchers::StartsWith("depth is not what it was"));
}

TEST_CASE("an optimum that not every half of the pairs has is a false one") {
  const Drive drive = spoilt_drive([](int i) { return test::knock(0, 0, i == 1 || i == 3 || i == 5 ? 0.8 : 2); },
                                   leave_alone, fitted + 1 + held);
  const Recalibration result = drive.search();
  CHECK_FALSE(result.accepted);
  CHECK_THAT(result.reason, Catch::Matchers::StartsWith("a false optimum"));
}

TEST_CASE("unobservable axes are not moved, and the result names them") {
  const test::AdversePlace field(test::PlaceKind::field, 5, fitted + held);
  Drive drive(RigidTransform::Identity(), 63, 0);
  drive.start = field.rig().T_camera_lidar;
  for (int i = 0; i < fitted + held; ++i) {
    const test::Sample sample = test::sound_sample(field, i, test::knock(1, 1, 1));
    drive.frames.push_back(test::require_ok(make_features(sample.pair, sample.depth, field.rig().camera, drive.start)));
  }
  drive.share_out(fitted);
  const Recalibration result = drive.search();
  INFO(result.reason);
  CHECK_FALSE(result.moved[2]);  // a plain looks the same whichever way one turns
  CHECK_THAT(result.reason, Catch::Matchers::ContainsSubstring("not observable and left as it was") &&
                                Catch::Matchers::ContainsSubstring("yaw"));
  for (int axis = 0; axis < 6; ++axis)
    if (!result.moved[axis]) CHECK(std::abs(result.delta[axis]) < 1e-9);
}

TEST_CASE("a recalibration that is to end ends at the next evaluation, whenever that is, with no result") {
  const Drive drive(test::knock(0, 0.8, -0.6));
  int asked = 0;
  REQUIRE(recalibrate(drive.fit, drive.held_back, drive.start, {.keep_going = [&] { return ++asked > 0; }}));
  const int all = asked;
  CHECK(all > 300);  // so it is asked every few milliseconds
  for (const int end : {1, 2, all / 100, all / 10, all / 4, all / 2, 3 * all / 4, all - 1}) {
    asked = 0;
    const auto result =
        recalibrate(drive.fit, drive.held_back, drive.start, {.keep_going = [&] { return ++asked < end; }});
    INFO(end << " of " << all);
    REQUIRE_FALSE(result);
    CHECK(result.error().code == "cancelled");
  }
}
