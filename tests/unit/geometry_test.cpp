#include "calib/geometry.hpp"

#include <cmath>
#include <limits>
#include <numbers>
#include <random>

#include "support/catch.hpp"
#include "support/support.hpp"

using namespace calib;
using Eigen::Vector3d;

namespace {

constexpr double pi = std::numbers::pi;
constexpr double not_a_number = std::numeric_limits<double>::quiet_NaN();

/// Rotations over the whole domain (|pitch| < pi/2), translations of metres.
Vector6 random_delta(std::mt19937& random) {
  std::uniform_real_distribution<double> unit(-1, 1);
  Vector6 delta;
  delta << pi * unit(random), 0.499 * pi * unit(random), pi * unit(random), unit(random), unit(random), unit(random);
  return delta;
}

}  // namespace

TEST_CASE("no perturbation is the identity") {
  CHECK(perturbation(Vector6::Zero()).isApprox(RigidTransform::Identity(), 0.0));
}

TEST_CASE("each entry of a perturbation turns or moves the way its name says") {
  const double angle = pi / 2;
  const auto turned = [&](int axis, const Vector3d& p) {
    Vector6 delta = Vector6::Zero();
    delta[axis] = angle;
    return Vector3d(perturbation(delta) * p);
  };
  CHECK((turned(0, Vector3d::UnitY()) - Vector3d::UnitZ()).norm() < 1e-15);  // roll: about x
  CHECK((turned(1, Vector3d::UnitZ()) - Vector3d::UnitX()).norm() < 1e-15);  // pitch: about y
  CHECK((turned(2, Vector3d::UnitX()) - Vector3d::UnitY()).norm() < 1e-15);  // yaw: about z
  for (int axis = 3; axis < 6; ++axis) {
    Vector6 delta = Vector6::Zero();
    delta[axis] = 2;
    CHECK((perturbation(delta) * Vector3d::Zero() - 2 * Vector3d::Unit(axis - 3)).norm() == 0);
  }
}

TEST_CASE("rotations compose as Rx Ry Rz: yaw acts first, roll last") {
  Vector6 delta = Vector6::Zero();
  delta.head<3>().setConstant(pi / 2);
  // x -yaw-> y -pitch-> y -roll-> z
  CHECK((perturbation(delta) * Vector3d::UnitX() - Vector3d::UnitZ()).norm() < 1e-15);
}

TEST_CASE("perturbation parameters invert a perturbation") {
  std::mt19937 random(1);
  for (int i = 0; i < 10'000; ++i) {
    const Vector6 delta = random_delta(random);
    REQUIRE((perturbation_parameters(perturbation(delta)) - delta).cwiseAbs().maxCoeff() < 1e-9);
  }
}

TEST_CASE("parameters taken at a pitch of 90 degrees give the same motion again") {
  Vector6 delta = Vector6::Zero();
  delta << 0.3, pi / 2, -0.2, 1, 2, 3;
  const RigidTransform motion = perturbation(delta);
  CHECK(perturbation(perturbation_parameters(motion)).isApprox(motion, 1e-7));
}

TEST_CASE("a perturbation about a pivot moves the pivot by its translation alone") {
  std::mt19937 random(2);
  const Vector3d pivot(15, -2, 0.5);
  for (int i = 0; i < 100; ++i) {
    const Vector6 delta = random_delta(random);
    const RigidTransform motion = perturbation_about(delta, pivot);
    REQUIRE((motion * pivot - pivot - delta.tail<3>()).norm() < 1e-12);
    REQUIRE(motion.linear().isApprox(perturbation(delta).linear()));
    REQUIRE(perturbation_about(delta, Vector3d::Zero()).isApprox(perturbation(delta)));
  }
}

TEST_CASE("a rotation angle is that of the axis-angle form, whichever way it turns") {
  const Vector3d axis = Vector3d(1, -2, 3).normalized();
  for (const double angle : {0.0, 1e-9, 0.01, 1.0, 3.0, pi}) {
    RigidTransform motion = RigidTransform::Identity();
    motion.linear() = Eigen::AngleAxisd(angle, axis).toRotationMatrix();
    CHECK(rotation_angle_rad(motion) == Approx(angle).margin(1e-8));
    CHECK(rotation_angle_rad(motion.inverse()) == Approx(angle).margin(1e-8));
  }
}

TEST_CASE("a transform survives the way through translation and quaternion, which has w >= 0") {
  std::mt19937 random(3);
  for (int i = 0; i < 1000; ++i) {
    const RigidTransform transform = perturbation(random_delta(random));
    const auto quaternion = quaternion_xyzw(transform);
    REQUIRE(quaternion[3] >= 0);
    const auto again = test::require_ok(make_transform(translation_m(transform), quaternion));
    REQUIRE(again.isApprox(transform, 1e-12));
  }
}

TEST_CASE("a quaternion is read as x, y, z, w") {
  const auto quarter_yaw = test::require_ok(make_transform({1, 2, 3}, {0, 0, std::sqrt(0.5), std::sqrt(0.5)}));
  CHECK((quarter_yaw * Vector3d::UnitX() - Vector3d(1, 3, 3)).norm() < 1e-12);
}

TEST_CASE("a quaternion that is a little off unit length is normalised, further off refused") {
  const auto nearly = test::require_ok(make_transform({0, 0, 0}, {0, 0, 0, 1.0009}));
  CHECK(nearly.linear().isApprox(Eigen::Matrix3d::Identity(), 1e-15));
  for (const double w : {0.0, 0.998, 1.002, 2.0}) {
    const auto result = make_transform({0, 0, 0}, {0, 0, 0, w});
    REQUIRE_FALSE(result);
    CHECK(result.error().code == "bad_transform");
  }
}

TEST_CASE("a transform with a number that is not finite is refused") {
  for (const double bad : {not_a_number, std::numeric_limits<double>::infinity()}) {
    for (int i = 0; i < 3; ++i) {
      std::array<double, 3> translation{};
      translation[i] = bad;
      CHECK_FALSE(make_transform(translation, {0, 0, 0, 1}));
    }
    for (int i = 0; i < 4; ++i) {
      std::array<double, 4> quaternion{0, 0, 0, 1};
      quaternion[i] = bad;
      CHECK_FALSE(make_transform({0, 0, 0}, quaternion));
    }
  }
}

TEST_CASE("roll, pitch and yaw are found again, also where the pitch is a right angle") {
  std::mt19937 random(3);
  for (int i = 0; i < 1000; ++i) {
    Vector6 delta = random_delta(random);
    if (i % 4 == 0) delta[1] = (i % 8 == 0 ? 0.5 : -0.5) * pi;
    if (i % 4 == 1) delta[1] = 0.5 * pi - 1e-9 * std::abs(delta[1]);
    const Eigen::Matrix3d R = rotation_from_rpy(delta.head<3>());
    CHECK((rotation_from_rpy(roll_pitch_yaw_rad(R)) - R).norm() < 1e-12);
  }
}

TEST_CASE("a matrix that is no rotation makes no transform") {
  const auto refused = [](const Eigen::Matrix3d& R) { return !transform_from_matrix({0, 0, 0}, R); };
  CHECK(refused(Eigen::Matrix3d::Zero()));
  CHECK(refused(-Eigen::Matrix3d::Identity()));
  CHECK(refused(Eigen::Matrix3d::Constant(not_a_number)));
  CHECK_FALSE(refused(Eigen::Matrix3d::Identity() * 1.0001));
  CHECK_FALSE(transform_from_matrix({0, not_a_number, 0}, Eigen::Matrix3d::Identity()));
}
