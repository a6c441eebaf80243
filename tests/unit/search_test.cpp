#include "calib/search.hpp"

#include <cmath>
#include <limits>

#include "support/catch.hpp"
#include "support/simulated_drive.hpp"

using namespace calib;

namespace {

constexpr std::array<bool, 6> rotation_only{true, true, true, false, false, false};
/// Sees all around, so that any orientation finds something in view.
constexpr vehicle::LidarModel all_around{.azimuth_step_deg = 0.4};

/// Depth that is wrong by up to 60 %, in another way in each corner of the image.
void bias(DepthMap& depth) {
  for (int v = 0; v < depth.height; ++v)
    for (int u = 0; u < depth.width; ++u) {
      const double x = 2.0 * u / depth.width - 1, y = 2.0 * v / depth.height - 1;
      depth.inverse_depth[v * depth.width + u] /= static_cast<float>(1 + 0.45 * x * y + 0.15 * x);
    }
}

/// Says nothing but that what is further down is nearer, and less so to the right: as a network may in a jam.
void flatten(DepthMap& depth) {
  for (int v = 0; v < depth.height; ++v)
    for (int u = 0; u < depth.width; ++u)
      depth.inverse_depth[v * depth.width + u] =
          0.02F + 0.2F * static_cast<float>(v) / static_cast<float>(depth.height) +
          0.05F * static_cast<float>(depth.width - u) / static_cast<float>(depth.width);
}

struct Street {
  explicit Street(std::uint64_t seed, int count, const FeatureSettings& settings = {},
                  void (*spoil)(DepthMap&) = nullptr,
                  const vehicle::LidarModel& lidar = {.azimuth_step_deg = 0.25, .field_of_view_deg = 110})
      : drive(seed, 640, 192, lidar) {
    for (int i = 0; i < count; ++i) {
      DepthMap depth = drive.depth(i);
      if (spoil != nullptr) spoil(depth);
      sets.push_back(
          test::require_ok(make_features(drive.pair(i), depth, drive.camera(), drive.T_camera_lidar(), settings)));
    }
    frames = test::pointers(sets);
  }
  [[nodiscard]] const RigidTransform& truth() const { return drive.T_camera_lidar(); }
  [[nodiscard]] double error_deg(const RigidTransform& T) const {
    return rotation_angle_rad(T.inverse() * truth()) / radians_per_degree;
  }

  test::SimulatedDrive drive;
  std::vector<FeatureSet> sets;
  std::vector<const FeatureSet*> frames;
};

}  // namespace

TEST_CASE("methods have names, and an unknown one is refused with those there are") {
  for (const Method method : {Method::standard, Method::d2d, Method::i2i, Method::i2i_nmi})
    CHECK(test::require_ok(parse_method(to_string(method))) == method);
  CHECK(test::require_ok(parse_method("default")) == Method::standard);
  const auto unknown = parse_method("best\x1b");
  REQUIRE_FALSE(unknown);
  CHECK(unknown.error().code == "unknown_objective");
  CHECK_THAT(unknown.error().context, Catch::Matchers::ContainsSubstring("i2i_nmi"));
  CHECK(unknown.error().context.find('\x1b') == std::string::npos);
}

TEST_CASE("the rotation is found from twenty degrees and from any orientation at all") {
  const Street street(71, 6, {.bounds = {.rotation_rad = 2}}, nullptr, all_around);
  SearchSettings settings{.bounds = {.rotation_rad = 26 * radians_per_degree, .translation_m = 0.1},
                          .free_axes = rotation_only};
  for (const auto& knock : {test::knock(0, 0, 2), test::knock(-3, 8, -5), test::knock(12, -11, -12)}) {
    const auto found = test::require_ok(search(street.frames, street.truth() * knock, Method::standard, settings));
    CHECK(street.error_deg(found.T_camera_lidar) < 0.1);
    CHECK(found.reason == "converged");
    CHECK((found.delta.tail<3>().array().abs() < 1e-12).all());
  }
  settings.any_orientation = true;
  for (const auto& knock : {test::knock(180, 0, 0), test::knock(70, -50, 130)}) {
    const auto found = test::require_ok(search(street.frames, street.truth() * knock, Method::standard, settings));
    CHECK(street.error_deg(found.T_camera_lidar) < 0.1);
  }
}

TEST_CASE("with monocular depth brightness and edges find the rotation where depth itself shows none") {
  const Street street(71, 6, {}, flatten);
  for (const auto& knock : {test::knock(0, 0, 0), test::knock(-0.4, 0.8, -0.5), test::knock(2, -3, 2)}) {
    const auto found = test::require_ok(search(street.frames, street.truth() * knock, Method::standard,
                                               {.bounds = {}, .free_axes = rotation_only, .monocular_depth = true}));
    CHECK(street.error_deg(found.T_camera_lidar) < 0.1);
    CHECK((found.delta.tail<3>().array().abs() < 1e-12).all());
  }
  const auto by_depth = test::require_ok(search(street.frames, street.truth() * test::knock(2, -3, 2), Method::standard,
                                                {.bounds = {}, .free_axes = rotation_only}));
  CHECK(street.error_deg(by_depth.T_camera_lidar) > 1);
}

TEST_CASE("all six are found, and only what is released moves") {
  const Street street(72, 8);
  const RigidTransform T = street.truth() * test::knock(0.6, -0.5, 0.7, 0.2, -0.3, 0.15);
  const auto all = test::require_ok(search(street.frames, T, Method::standard));
  CHECK(street.error_deg(all.T_camera_lidar) < 0.15);
  CHECK((all.T_camera_lidar.inverse() * street.truth()).translation().norm() < 0.08);
  CHECK_FALSE(all.depth_is_biased);
  CHECK(all.score_after > all.score_before);

  const RigidTransform T_yawed = street.truth() * test::knock(0, 0, 1.5);
  const auto yaw = test::require_ok(search(street.frames, T_yawed, Method::standard,
                                           {.bounds = {}, .free_axes = {false, false, true, false, false, false}}));
  CHECK(street.error_deg(yaw.T_camera_lidar) < 0.1);
  for (const int axis : {0, 1, 3, 4, 5}) CHECK(std::abs(yaw.delta[axis]) < 1e-12);
}

TEST_CASE("nothing leaves the bounds, and the result says where it ended") {
  const Street street(73, 4);
  const SearchSettings narrow{.bounds = {.rotation_rad = radians_per_degree, .translation_m = 0.1},
                              .free_axes = rotation_only};
  const auto found =
      test::require_ok(search(street.frames, street.truth() * test::knock(0, 0, 2), Method::standard, narrow));
  CHECK(found.ends_at_limit);
  CHECK(found.reason == "ends at the limit of yaw");
  CHECK(std::abs(found.delta[2]) <= 1.02 * radians_per_degree);
  // Narrower than any first step.
  const SearchSettings hardly{.bounds = {.rotation_rad = 0.1 * radians_per_degree, .translation_m = 0.02}};
  const auto held = test::require_ok(search(street.frames, street.truth(), Method::standard, hardly));
  CHECK(held.delta.head<3>().cwiseAbs().maxCoeff() <= 0.11 * radians_per_degree);
}

TEST_CASE("depth that is biased across the image moves the rotation little, and good depth is not called biased") {
  const bool biased = GENERATE(false, true);
  const Street street(74, 8, {}, biased ? bias : nullptr);
  const RigidTransform T = street.truth() * test::knock(1, 0.5, -1);
  const auto rotation =
      test::require_ok(search(street.frames, T, Method::standard, {.bounds = {}, .free_axes = rotation_only}));
  CHECK(street.error_deg(rotation.T_camera_lidar) < 0.15);
  const auto all = test::require_ok(search(street.frames, T, Method::standard));
  if (!biased) CHECK_FALSE(all.depth_is_biased);
  CHECK(street.error_deg(all.T_camera_lidar) < 0.3);
}

TEST_CASE("the published methods find their own maximum from a start near it") {
  const Street street(75, 6, {.baselines = true});
  const RigidTransform T = street.truth() * test::knock(0, 0, 0.6);
  for (const Method method : {Method::d2d, Method::i2i, Method::i2i_nmi}) {
    const auto found = test::require_ok(
        search(street.frames, T, method,
               {.bounds = {.rotation_rad = 2 * radians_per_degree, .translation_m = 0.1}, .free_axes = rotation_only}));
    CHECK(found.score_after > found.score_before);
    CHECK(found.evaluations < 400);
    if (method == Method::d2d) CHECK(street.error_deg(found.T_camera_lidar) < 0.5);
  }
}

TEST_CASE("the same search ends the same to the last bit") {
  const Street street(76, 4);
  const RigidTransform T = street.truth() * test::knock(0.3, 0.4, 0.5, 0.1, 0, 0);
  const auto once = test::require_ok(search(street.frames, T, Method::standard));
  const auto again = test::require_ok(search(street.frames, T, Method::standard));
  CHECK(once.T_camera_lidar.matrix() == again.T_camera_lidar.matrix());
  CHECK(once.score_after == again.score_after);
  CHECK(once.evaluations == again.evaluations);
}

TEST_CASE("no frame, no axis and what is no number are refused") {
  const Street street(77, 2);
  CHECK(search({}, street.truth(), Method::standard).error().code == "too_few_pairs");
  CHECK(search(street.frames, street.truth(), Method::standard, {.bounds = {}, .free_axes = {}}).error().code ==
        "search_failed");
  const SearchSettings half{.bounds = {}, .any_orientation = true, .free_axes = {true, false, true}};
  CHECK(search(street.frames, street.truth(), Method::standard, half).error().code == "search_failed");
  RigidTransform not_a_number = street.truth();
  not_a_number.translation().setConstant(std::numeric_limits<double>::quiet_NaN());
  CHECK_FALSE(search(street.frames, not_a_number, Method::standard));
}

TEST_CASE("the uncertainty covers the error, shrinks with more frames, and finds no maximum in noise") {
  const Street street(78, 16);
  const Frames all = street.frames;
  const Objective objective = final_objective(Method::standard, rotation_only);
  const SearchSettings settings{.bounds = {}, .free_axes = rotation_only};
  const auto found = test::require_ok(search(all, street.truth(), Method::standard, settings));
  const Uncertainty of_all = uncertainty(all, found.T_camera_lidar, objective, settings);
  const Uncertainty of_four = uncertainty(all.first(4), found.T_camera_lidar, objective, settings);
  for (int axis = 0; axis < 3; ++axis) {
    CHECK(of_all.observable[axis]);
    CHECK(of_all.sigma()[axis] > 0);
    CHECK(of_all.sigma()[axis] < 0.2 * radians_per_degree);
    CHECK(std::abs(found.delta[axis]) < 5 * of_all.sigma()[axis] + 0.05 * radians_per_degree);
    const double ratio = of_all.covariance(axis, axis) / of_all.bootstrap_covariance(axis, axis);
    CHECK((ratio > 0.2 && ratio < 5));
  }
  CHECK(of_all.sigma().head<3>().sum() < of_four.sigma().head<3>().sum());
  CHECK(of_all.covariance.isApprox(of_all.covariance.transpose()));
  CHECK(of_all.sigma().tail<3>().isZero());

  // Depth of another scene carries no information about any axis.
  std::vector<FeatureSet> wrong = street.sets;
  for (std::size_t i = 0; i < wrong.size(); ++i) wrong[i].planes = street.sets[(i + 7) % wrong.size()].planes;
  const Uncertainty of_wrong = uncertainty(test::pointers(wrong), street.truth(), objective, settings);
  int observable = 0;
  for (const bool axis : of_wrong.observable) observable += axis;
  CHECK(observable < 3);
}
