#include <numbers>
#include <random>
#include <tuple>

#include "extrinsic_formats/formats.hpp"
#include "extrinsic_formats/plausibility.hpp"
#include "support/catch.hpp"
#include "support/support.hpp"

using namespace calib;
using namespace calib::formats;

namespace {

RigidTransform random_transform(std::mt19937& random) {
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> metres(-10, 10);
  const Eigen::Quaterniond q(normal(random), normal(random), normal(random), normal(random));
  RigidTransform T = RigidTransform::Identity();
  T.linear() = q.normalized().toRotationMatrix();
  T.translation() = Eigen::Vector3d(metres(random), metres(random), metres(random));
  return T;
}

/// The graph of one file's frames.
FrameGraph graph_of(Format format, const std::string& text) {
  FrameGraph graph;
  for (FrameEdge& edge : test::require_ok(read_frames(format, {{"file", text}})).edges)
    REQUIRE(graph.add(std::move(edge)));
  return graph;
}

std::string refusal(Format format, const std::string& text) {
  const auto frames = read_frames(format, {{"file", text}});
  return frames ? "accepted" : frames.error().context;
}

constexpr double bound = 1e-9;

/// T_camera_lidar of a camera that looks where the LiDAR's x axis points.
RigidTransform forward() {
  RigidTransform T = T_optical_body();
  T.translation() = Eigen::Vector3d(0.1, -0.2, -0.3);
  return T;
}

}  // namespace

TEST_CASE("what is written in any format is read as the same extrinsic") {
  std::mt19937 random(5);
  for (const FormatFacts& facts : all_formats)
    for (int i = 0; i < 300; ++i) {
      CAPTURE(facts.name, i);
      Extrinsic extrinsic{.T_camera_lidar = random_transform(random),
                          .camera = std::string(facts.camera),
                          .lidar = std::string(facts.lidar),
                          .parent = std::string(i % 3 == 0 ? facts.camera : facts.lidar),
                          .known = {},
                          .tf_form = static_cast<TfForm>(i % 3)};
      if (facts.is_tree && i % 3 == 2) {
        extrinsic.parent = "base_link";
        const auto added = extrinsic.known.add({"base_link", extrinsic.lidar, random_transform(random), "known"});
        REQUIRE(added);
      }
      FrameGraph graph = graph_of(facts.format, test::require_ok(write_extrinsic(facts.format, extrinsic)));
      if (extrinsic.parent == "base_link" && facts.format != Format::nuscenes)
        REQUIRE(graph.add({"base_link", extrinsic.lidar,
                           test::require_ok(extrinsic.known.transform("base_link", extrinsic.lidar)), "known"}));
      const auto T = test::require_ok(graph.transform(extrinsic.camera, extrinsic.lidar));
      const RigidTransform difference = T * extrinsic.T_camera_lidar.inverse();
      CHECK(rotation_angle_rad(difference) < bound);
      CHECK(difference.translation().norm() < bound);
    }
}

TEST_CASE("a camera's new pose in a vehicle replaces the old one, by which nothing is found") {
  Extrinsic extrinsic{.T_camera_lidar = forward(), .camera = "cam", .lidar = "lidar", .parent = "base", .known = {}};
  REQUIRE(extrinsic.known.add({"base", "cam", RigidTransform::Identity(), "old"}));
  REQUIRE(extrinsic.known.add({"cam", "lidar", RigidTransform::Identity(), "old"}));
  const auto text = write_extrinsic(Format::urdf, extrinsic);
  REQUIRE_FALSE(text);
  CHECK_THAT(text.error().context,
             Catch::Matchers::ContainsSubstring("no chain of transforms leads from 'lidar' to 'base'"));
}

TEST_CASE("positional arguments of static_transform_publisher have yaw first, the options roll") {
  const double quarter = std::numbers::pi / 2;
  const std::string angle = number_text(quarter);
  const auto yawed = graph_of(Format::tf, "static_transform_publisher 1 2 3 " + angle + " 0 0 a b");
  const auto ros1 = graph_of(Format::tf, "static_transform_publisher 1 2 3 " + angle + " 0 0 a b 100");
  const auto named = graph_of(Format::tf, "--x 1 --y 2 --z 3 --yaw=" + angle + " --frame-id a --child-frame-id b");
  RigidTransform expected = RigidTransform::Identity();
  expected.linear() << 0, -1, 0, 1, 0, 0, 0, 0, 1;
  expected.translation() = Eigen::Vector3d(1, 2, 3);
  for (const FrameGraph* graph : {&yawed, &ros1, &named})
    CHECK(test::require_ok(graph->transform("a", "b")).isApprox(expected, 1e-12));
}

TEST_CASE("a file that breaks its format is refused with the key and what is wrong") {
  const std::string stamped =
      "transforms: [{header: {frame_id: a}, child_frame_id: b, transform: {translation: {x: 0, y: 0, z: 0}, "
      "rotation: {x: 0, y: 0, z: 0, w: 0.9}}}]";
  const std::tuple<Format, std::string, std::string> refused[] = {
      {Format::tf, stamped, "file:1: transforms[0].transform.rotation: quaternion_xyzw has norm 0.9"},
      {Format::tf, "transforms: []\n---\na: 1\n", "file:3: header: missing"},
      {Format::tf, "static_transform_publisher 1 2 3 a b", "file: static_transform_publisher needs x y z"},
      {Format::tf, "static_transform_publisher 1 2 x 0 0 0 a b", "file: argument 3: 'x' is no number"},
      {Format::tf, "--x nan --frame-id a --child-frame-id b", "file: --x: 'nan' is no number"},
      {Format::tf, "--x 1 --frame-id a", "file: --child-frame-id: missing"},
      {Format::tf, "--q 1 --frame-id a", "file: --q: is no option"},
      {Format::kitti, "R: 1 0 0 0 1 0 0 0 1\nT: 1 2\n", "file: T: has 2 numbers and needs 3"},
      {Format::kitti, "R: 1 0 0 0 1 0 0 0 2\nT: 1 2 3\n", "file: R: is not a rotation"},
      {Format::kitti, "R: 1 0 0 0 1 0 0 0 1\nT: 1 2 inf\n", "file: T: missing, or not all numbers"},
      {Format::kitti, "", "file: R: missing"},
      {Format::kitti, "R_rect_00: 1 0 0 0 1 0 0 0 1\nP_rect_00: 0 0 0 0 0 0 0 0 0 0 0 0\n",
       "P_rect_00: its left three"},
      {Format::kitti360, "1 0 0 0 0 1 0 0 0 0 1", "file: matrix: has 11 numbers and needs 12"},
      {Format::autoware, "base: {cam: {x: 0, y: 0, z: 0, roll: 0, pitch: 0}}", "file:1: base.cam.yaw: missing"},
      {Format::autoware, "base: {cam: {x: 0, y: 0, z: 0, roll: 0, pitch: 0, yaw: 90}}", "yaw: 90 is outside -10 .. 10"},
      {Format::autoware, "base: {cam: 1}", "file:1: base.cam: needs a mapping"},
      {Format::kalibr, "cam0: {T_cam_lidar: [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1.1, 0]]}",
       "cam0.T_cam_lidar: is not a"},
      {Format::kalibr, "cam0: {T_cn_cnm1: []}", "file:1: cam0.T_cn_cnm1: cam0 has no camera before it"},
      {Format::kalibr, "imu0: {}", "file:1: holds no camera cam0"},
      {Format::urdf, "<robot>", "file: line "},
      {Format::urdf, "<sdf/>", "file: holds no element robot"},
      {Format::urdf, "<robot><joint name='j' type='fixed'><parent link='a'/></joint></robot>",
       "file: joint 'j' (line 1): child"},
      {Format::urdf,
       "<robot><joint name='j' type='fixed'><parent link='a'/><child link='b'/><origin rpy='0 0 "
       "${pi}'/></joint></robot>",
       "joint 'j' (line 1): rpy: is not expanded; run xacro first"},
      {Format::urdf,
       "<robot><joint name='j' type='fixed'><parent link='a'/><child link='b'/><origin rpy='0 0 90'/></joint></robot>",
       "rpy: 90.0 is beyond 10.0"},
      {Format::opencalib, "[", "file: is not JSON"},
      {Format::opencalib, "{}", "file: needs an object"},
      {Format::opencalib, R"({"k": {"sensor_name": "a", "target_sensor_name": "b"}})",
       "file: k.param.sensor_calib: missing"},
      {Format::nuscenes, "{}", "file: needs a list"},
      {Format::nuscenes,
       R"([{"token": "t", "sensor_token": "s", "translation": [0, 0, 1e9], "rotation": [1, 0, 0, 0]}])",
       "file: [0].translation: a number is beyond 1e7"},
      {Format::nuscenes, R"([{"token": "t", "sensor_token": "s", "translation": [0, 0, 1], "rotation": [1, 0, 0]}])",
       "file: [0].rotation: needs a list of 4 numbers"},
  };
  for (const auto& [format, text, expected] : refused) {
    CAPTURE(text);
    CHECK_THAT(refusal(format, text), Catch::Matchers::ContainsSubstring(expected));
  }
}

TEST_CASE("two poses of one frame in another are refused, the same one twice is not") {
  FrameGraph graph;
  RigidTransform T = RigidTransform::Identity();
  CHECK(graph.add({"a", "b", T, "one"}));
  CHECK(graph.add({"a", "b", T, "two"}));
  T.translation().x() = 0.1;
  CHECK_FALSE(graph.add({"a", "b", T, "three"}));
  CHECK_FALSE(graph.add({"a", "a", T, "four"}));
}

TEST_CASE("a wrong direction and a wrong camera frame are seen, with the reading that sets them right") {
  const Reading optical{false, CameraAxes::optical}, body{false, CameraAxes::body}, inverse{true, CameraAxes::optical},
      inverse_body{true, CameraAxes::body};
  const RigidTransform T = forward(), T_body = T_optical_body().inverse() * T;
  CHECK_FALSE(doubt_about(T, optical));
  CHECK_FALSE(doubt_about(T_body, body));
  CHECK_FALSE(doubt_about(T.inverse(), inverse));
  CHECK_FALSE(doubt_about(T_body.inverse(), inverse_body));
  const auto better = [](const RigidTransform& given, const Reading& reading) {
    const auto doubt = doubt_about(given, reading);
    REQUIRE(doubt);
    REQUIRE(doubt->better);
    return *doubt->better;
  };
  CHECK(better(T.inverse(), optical) == inverse);
  CHECK(better(T, inverse) == optical);
  CHECK(better(T_body, optical) == body);
  CHECK(better(T, body) == optical);
  CHECK_THAT(doubt_about(T.inverse(), optical)->words, Catch::Matchers::ContainsSubstring("looks like its inverse"));
}

TEST_CASE("a camera on its side is not doubted") {
  for (const double degrees : {90.0, -90.0, 180.0}) {
    RigidTransform T = forward();
    T.linear() = rotation_from_rpy({0, 0, degrees * radians_per_degree}) * T.linear();
    CHECK_FALSE(doubt_about(T, {}));
  }
}

TEST_CASE("names that a file cannot hold safely are no frame names") {
  for (const char* name : {"camera0/camera_link", "CAM_FRONT", "a.b-c"}) CHECK(is_frame_name(name));
  for (const char* name : {"", "a b", "a\"b", "a:b", "-a", "a\nb", "a<b", "$(x)"}) CHECK_FALSE(is_frame_name(name));
  CHECK_FALSE(is_frame_name(std::string(129, 'a')));
}
