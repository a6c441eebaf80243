#include "calib/camera.hpp"

#include <limits>
#include <opencv2/calib3d.hpp>
#include <random>

#include "support/catch.hpp"
#include "support/support.hpp"

using namespace calib;
using Eigen::Vector2d;
using Eigen::Vector3d;

namespace {

constexpr double not_a_number = std::numeric_limits<double>::quiet_NaN();

// The kind of lens that a vehicle carries: barrel distortion of 10 % and a decentred element.
const std::vector<double> intrinsics{721.5, 718.2, 609.6, 172.9};
const std::vector<double> distortion{-0.28, 0.09, 1.2e-3, -7e-4, -0.01};

Camera rectified() { return test::require_ok(Camera::make(CameraModel::rectified, 1242, 375, intrinsics)); }
Camera plumb_bob() {
  return test::require_ok(Camera::make(CameraModel::plumb_bob, 1242, 375, intrinsics, distortion));
}

}  // namespace

TEST_CASE("a rectified camera is a pinhole") {
  const auto uv = rectified().project({2, -1, 10});
  REQUIRE(uv);
  CHECK(uv->x() == Approx(721.5 * 0.2 + 609.6));
  CHECK(uv->y() == Approx(718.2 * -0.1 + 172.9));
}

TEST_CASE("plumb_bob puts points where OpenCV puts them") {
  const Camera camera = plumb_bob();
  std::mt19937 random(1);
  std::uniform_real_distribution<double> u(0, 1241), v(0, 374), range(0.5, 100);
  std::vector<cv::Point3d> points;
  while (points.size() < 100'000) {
    const auto bearing = camera.unproject({u(random), v(random)});
    REQUIRE(bearing);
    const Vector3d p = *bearing * range(random);
    points.emplace_back(p.x(), p.y(), p.z());
  }
  const cv::Matx33d K(intrinsics[0], 0, intrinsics[2], 0, intrinsics[1], intrinsics[3], 0, 0, 1);
  std::vector<cv::Point2d> expected;
  cv::projectPoints(points, cv::Vec3d(), cv::Vec3d(), K, distortion, expected);
  double worst = 0;
  for (std::size_t i = 0; i < points.size(); ++i) {
    const auto uv = camera.project({points[i].x, points[i].y, points[i].z});
    REQUIRE(uv);
    worst = std::max(worst, (*uv - Vector2d(expected[i].x, expected[i].y)).norm());
  }
  CHECK(worst < 1e-6);
}

TEST_CASE("projecting the bearing of a pixel gives the pixel") {
  std::mt19937 random(2);
  std::uniform_real_distribution<double> u(-0.5, 1241.4), v(-0.5, 374.4), range(0.5, 100);
  for (const Camera& camera : {rectified(), plumb_bob()}) {
    for (int i = 0; i < 10'000; ++i) {
      const Vector2d uv(u(random), v(random));
      const auto bearing = camera.unproject(uv);
      REQUIRE(bearing);
      REQUIRE(bearing->norm() == Approx(1));
      const auto again = camera.project(*bearing * range(random));
      REQUIRE(again);
      REQUIRE((*again - uv).norm() < 1e-6);
    }
  }
}

TEST_CASE("a point beyond the fold of the distortion is not visible, although its formula gives a pixel in the image") {
  // r (1 - 0.4 r^2) stops growing at r = 1 / sqrt(1.2) = 0.913 and is back on the axis at r = 1.58.
  const Camera camera =
      test::require_ok(Camera::make(CameraModel::plumb_bob, 1000, 1000, {300, 300, 500, 500}, {-0.4, 0, 0, 0}));
  CHECK(camera.project({0.90, 0, 1}));
  CHECK_FALSE(camera.project({0.93, 0, 1}));
  CHECK_FALSE(camera.project({1.58, 0, 1}));
  CHECK_FALSE(camera.project({0, -1.58, 1}));
  CHECK_FALSE(camera.unproject({500 + 300 * 0.65, 500}));  // the polynomial's largest value is 0.609
}

TEST_CASE("points behind the camera, in its centre or not finite are not visible") {
  for (const Camera& camera : {rectified(), plumb_bob()}) {
    CHECK_FALSE(camera.project({0, 0, -5}));
    CHECK_FALSE(camera.project({0, 0, 0}));
    for (int i = 0; i < 3; ++i) {
      Vector3d p(0, 0, 5);
      p[i] = not_a_number;
      CHECK_FALSE(camera.project(p));
    }
    CHECK_FALSE(camera.unproject({not_a_number, 0}));
  }
}

TEST_CASE("the image ends at the outer edges of its border pixels") {
  const Camera camera = test::require_ok(Camera::make(CameraModel::rectified, 100, 50, {100, 100, 0, 0}));
  const auto visible = [&](double u, double v) { return camera.project({u / 100, v / 100, 1}).has_value(); };
  CHECK(visible(-0.49, -0.49));
  CHECK(visible(99.49, 49.49));
  CHECK_FALSE(visible(-0.51, 0));
  CHECK_FALSE(visible(99.51, 0));
  CHECK_FALSE(visible(0, -0.51));
  CHECK_FALSE(visible(0, 49.51));
}

TEST_CASE("four distortion parameters mean that k3 is zero") {
  const auto four = test::require_ok(
      Camera::make(CameraModel::plumb_bob, 1242, 375, intrinsics, {distortion.begin(), distortion.begin() + 4}));
  const auto five = test::require_ok(Camera::make(CameraModel::plumb_bob, 1242, 375, intrinsics,
                                                  {distortion[0], distortion[1], distortion[2], distortion[3], 0}));
  CHECK(*four.project({3, 1, 10}) == *five.project({3, 1, 10}));
}

TEST_CASE("impossible parameters are refused with a sentence") {
  struct Bad {
    CameraModel model;
    int width, height;
    std::vector<double> intrinsics, distortion;
  };
  const std::vector<Bad> all{
      {CameraModel::rectified, 0, 375, intrinsics, {}},
      {CameraModel::rectified, 1242, -1, intrinsics, {}},
      {CameraModel::rectified, 100'000, 100'000, intrinsics, {}},
      {CameraModel::rectified, 1242, 375, {}, {}},
      {CameraModel::rectified, 1242, 375, {700, 700, 600}, {}},
      {CameraModel::rectified, 1242, 375, {0, 700, 600, 170}, {}},
      {CameraModel::rectified, 1242, 375, {700, -700, 600, 170}, {}},
      {CameraModel::rectified, 1242, 375, {700, 1e6, 600, 170}, {}},
      {CameraModel::rectified, 1242, 375, {700, 700, not_a_number, 170}, {}},
      {CameraModel::rectified, 1242, 375, intrinsics, distortion},
      {CameraModel::plumb_bob, 1242, 375, intrinsics, {}},
      {CameraModel::plumb_bob, 1242, 375, intrinsics, {0, 0, 0}},
      {CameraModel::plumb_bob, 1242, 375, intrinsics, {0, 0, not_a_number, 0, 0}},
  };
  for (const Bad& bad : all) {
    const auto camera = Camera::make(bad.model, bad.width, bad.height, bad.intrinsics, bad.distortion);
    REQUIRE_FALSE(camera);
    CHECK(camera.error().code == "bad_camera");
    CHECK_FALSE(camera.error().context.empty());
  }
}

TEST_CASE("a camera model is known by its name alone") {
  for (const CameraModel model : {CameraModel::rectified, CameraModel::plumb_bob})
    CHECK(test::require_ok(parse_camera_model(to_string(model))) == model);
  CHECK_FALSE(parse_camera_model(""));
  CHECK_FALSE(parse_camera_model("Rectified"));
  CHECK_THAT(parse_camera_model("\x1b[31m").error().context, !Catch::Matchers::ContainsSubstring("\x1b"));
}
