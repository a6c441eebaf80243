#include "calib/config_transform.hpp"

#include <numbers>

#include "support/catch.hpp"
#include "support/support.hpp"

using namespace calib;

namespace {

/// What `T: VALUE` is read as, or the message that it is refused with.
Result<RigidTransform> read(const std::string& value) {
  RigidTransform T = RigidTransform::Identity();
  const auto done = parse_config_text("T: " + value + "\n", "c.yaml",
                                      [&](const ConfigNode& node) { T = read_transform(node.at("T")); });
  if (!done) return propagate(done);
  return T;
}

std::string refusal(const std::string& value) {
  const auto T = read(value);
  return T ? "accepted" : T.error().context;
}

}  // namespace

TEST_CASE("all forms of a transform are read as the same") {
  const auto T = test::require_ok(read("{translation_m: [0.1, -0.2, 0.3], quaternion_xyzw: [0.5, -0.5, 0.5, 0.5]}"));
  for (const char* form : {"{translation_m: [0.1, -0.2, 0.3], rpy_deg: [90, -90, 0]}",
                           "{matrix: [[0, -1, 0, 0.1], [0, 0, -1, -0.2], [1, 0, 0, 0.3]]}",
                           "{matrix: [[0, -1, 0, 0.1], [0, 0, -1, -0.2], [1, 0, 0, 0.3], [0, 0, 0, 1]]}",
                           "{matrix: [0, -1, 0, 0.1, 0, 0, -1, -0.2, 1, 0, 0, 0.3]}",
                           "{matrix: [0, -1, 0, 0.1, 0, 0, -1, -0.2, 1, 0, 0, 0.3, 0, 0, 0, 1]}"}) {
    CAPTURE(form);
    CHECK(test::require_ok(read(form)).isApprox(T, 1e-12));
  }
}

TEST_CASE("roll, pitch and yaw turn about fixed axes: roll first") {
  const auto T = test::require_ok(read("{translation_m: [0, 0, 0], rpy_deg: [90, 0, 90]}"));
  CHECK((T * Eigen::Vector3d::UnitY() - Eigen::Vector3d::UnitZ()).norm() < 1e-12);
  CHECK((T * Eigen::Vector3d::UnitX() - Eigen::Vector3d::UnitY()).norm() < 1e-12);
}

TEST_CASE("a matrix of few digits becomes the nearest rotation") {
  const auto T = test::require_ok(read("{matrix: [[0.866, -0.5, 0, 1], [0.5, 0.866, 0, 2], [0, 0, 1, 3]]}"));
  CHECK((T.linear() * T.linear().transpose() - Eigen::Matrix3d::Identity()).norm() < 1e-14);
  CHECK(std::abs(rotation_angle_rad(T) - std::numbers::pi / 6) < 1e-4);
}

TEST_CASE("a transform that is none is refused with its key and what is wrong") {
  const std::pair<std::string, std::string> refused[] = {
      {"{matrix: [[1, 0, 0, 0], [0, 1.1, 0, 0], [0, 0, 1, 0]]}",
       "c.yaml:1: T.matrix: is not a rotation: an entry of R R^T differs from the identity by 0.21, and at most 0.001 "
       "is "
       "allowed"},
      {"{matrix: [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, -1, 0]]}", "c.yaml:1: T.matrix: is a reflection"},
      {"{matrix: [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 2]]}",
       "T.matrix: needs 0, 0, 0, 1 as its last row"},
      {"{matrix: [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, .nan]]}", "T.matrix[2][3]: needs a number"},
      {"{matrix: [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 101]]}", "T.matrix[2][3]: 101 is outside -100 .. 100"},
      {"{matrix: [[1, 0, 0], [0, 1, 0], [0, 0, 1]]}", "T.matrix[0]: needs a list of 4 numbers"},
      {"{matrix: [1, 0, 0]}", "T.matrix[0]: needs a list of 4 numbers"},
      {"{matrix: [1, 0, 0, 0, 0]}", "T.matrix: needs 3 or 4 rows"},
      {"{matrix: 1}", "T.matrix: needs a list"},
      {"{matrix: [], translation_m: [0, 0, 0]}", "T: holds two forms"},
      {"{translation_m: [0, 0, 0], rpy_deg: [0, 0, 0], quaternion_xyzw: [0, 0, 0, 1]}", "T: holds two forms"},
      {"{translation_m: [0, 0, 0], rpy_deg: [0, 0, 361]}", "T.rpy_deg[2]: 361 is outside -360 .. 360"},
      {"{translation_m: [0, 0, 0], rpy_deg: [0, inf, 0]}", "T.rpy_deg[1]: needs a number"},
      {"{translation_m: [0, 0, 0], rpy_rad: [0, 0, 0]}", "T.rpy_rad: unknown key; known keys are translation_m, "},
      {"{rpy_deg: [0, 0, 0]}", "T.translation_m: missing"},
      {"{translation_m: [0, 0, 0]}", "T.quaternion_xyzw: missing"},
  };
  for (const auto& [value, expected] : refused) {
    CAPTURE(value);
    CHECK_THAT(refusal(value), Catch::Matchers::ContainsSubstring(expected));
  }
}
