#include "calib/misalignment.hpp"

#include "support/catch.hpp"
#include "support/simulated_drive.hpp"

using namespace calib;

namespace {

constexpr int frames = 8;

/// A LiDAR that has moved, and the extrinsic of before.
Result<Misalignment> after(test::SimulatedDrive& drive, const RigidTransform& motion, SearchSettings settings = {}) {
  const auto sets = drive.features_of(frames, motion);
  return find_misalignment(test::pointers(sets), drive.T_camera_lidar(), std::move(settings));
}

}  // namespace

TEST_CASE("how far a LiDAR has moved is estimated with an error as large as is said") {
  test::SimulatedDrive drive(81);
  for (const auto& motion :
       {test::knock(0.5, 0, 0), test::knock(0, -1.5, 0), test::knock(0, 0, 3), test::knock(0, 0, 0, 0.1, 0.1, 0)}) {
    const Misalignment found = test::require_ok(after(drive, motion));
    const Vector6 truth = perturbation_parameters(motion), sigma = found.sigma();
    for (int axis = 0; axis < 6; ++axis) {
      INFO(axis << " moved " << truth[axis] << " found " << found.delta[axis] << " +- " << sigma[axis]);
      CHECK(std::abs(found.delta[axis] - truth[axis]) < 3 * sigma[axis]);
      if (motion.translation().isZero()) CHECK((axis >= 3 || sigma[axis] < 0.3 * radians_per_degree));
    }
  }
}

TEST_CASE("with monocular depth the translation is as uncertain as the bounds are wide, and not moved") {
  test::SimulatedDrive drive(82);
  const SearchSettings settings{.bounds = {.rotation_rad = 5 * radians_per_degree, .translation_m = 0.5},
                                .monocular_depth = true};
  const Misalignment found = test::require_ok(after(drive, test::knock(0, 0, 1), settings));
  CHECK(found.delta[2] == Approx(radians_per_degree).margin(0.15 * radians_per_degree));
  CHECK(found.sigma()[2] < 0.2 * radians_per_degree);
  for (int axis = 3; axis < 6; ++axis) {
    CHECK(found.delta[axis] == Approx(0).margin(1e-9));
    CHECK(found.sigma()[axis] == Approx(0.5));
  }
}

TEST_CASE("an optimum beyond the bounds, few pairs and a search that is ended give no estimate") {
  test::SimulatedDrive drive(83);
  CHECK(after(drive, test::knock(0, 0, 3), {.bounds = {.rotation_rad = radians_per_degree, .translation_m = 0.1}})
            .error()
            .code == "search_failed");
  CHECK(after(drive, test::knock(0, 0, 1), {.keep_going = [] { return false; }}).error().code == "cancelled");
  const auto few = drive.features_of(fewest_misalignment_frames - 1, test::knock(0, 0, 1));
  const auto none = find_misalignment(test::pointers(few), drive.T_camera_lidar(), {});
  CHECK(none.error().code == "too_few_pairs");
  CHECK_THAT(none.error().context, Catch::Matchers::ContainsSubstring("7 pairs, and at least 8 are needed"));
}
