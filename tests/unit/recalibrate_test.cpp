#include "calib/recalibrate.hpp"

#include <algorithm>
#include <limits>

#include "calib/drift.hpp"
#include "support/catch.hpp"
#include "support/simulated_drive.hpp"

using namespace calib;

namespace {

constexpr int fitted = 8, held = 4;

/// Pairs of a LiDAR that was knocked by `motion`: those to fit, and those held back.
struct Drive {
  explicit Drive(const RigidTransform& motion, std::uint64_t seed = 61) : simulated(seed) {
    frames = simulated.features_of(fitted + held, motion);
    const auto all = test::pointers(frames);
    fit.assign(all.begin(), all.begin() + fitted);
    held_back.assign(all.begin() + fitted, all.end());
  }
  [[nodiscard]] Recalibration search(const RecalibrationSettings& settings = {}) const {
    return test::require_ok(recalibrate(fit, held_back, simulated.T_camera_lidar(), settings));
  }

  test::SimulatedDrive simulated;
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

TEST_CASE("where translation may not change, none does, and the rotation is found all the same") {
  const Drive drive(test::knock(0, 0, 1, 0.2, 0.2, 0));
  const Recalibration result = drive.search({.bounds = {}, .translation = false});
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
    return result ? "" : result.error().code;
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
