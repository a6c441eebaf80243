#include "calib/camera.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <functional>
#include <limits>
#include <map>
#include <numbers>
#include <opencv2/calib3d.hpp>
#include <opencv2/ccalib/omnidir.hpp>
#include <random>
#include <set>

#include "calib/geometry.hpp"
#include "support/catch.hpp"
#include "support/support.hpp"

using namespace calib;
using Eigen::Vector2d;
using Eigen::Vector3d;

namespace {

constexpr double not_a_number = std::numeric_limits<double>::quiet_NaN();
constexpr double infinity = std::numeric_limits<double>::infinity();

struct Parameters {
  CameraModel model;
  int width, height;
  std::vector<double> intrinsics, distortion;

  [[nodiscard]] Camera camera() const {
    return test::require_ok(Camera::make(model, width, height, intrinsics, distortion));
  }
};

// The kinds of lens that a vehicle carries, each with its decentred element where the model has one.
const Parameters rectified{CameraModel::rectified, 1242, 375, {721.5, 718.2, 609.6, 172.9}, {}};
const Parameters plumb_bob{
    CameraModel::plumb_bob, 1242, 375, {721.5, 718.2, 609.6, 172.9}, {-0.28, 0.09, 1.2e-3, -7e-4, -0.01}};
const Parameters rational{CameraModel::rational_polynomial,
                          1280,
                          720,
                          {610, 611, 640.5, 366},
                          {0.62, -2.7, 8e-4, -3e-4, 1.6, 0.5, -2.5, 1.5}};
const Parameters equidistant{CameraModel::equidistant, 1280, 960, {330, 331, 641, 478}, {0.02, -0.006, 0.001, -0.0004}};
const Parameters double_sphere{CameraModel::double_sphere, 1280, 960, {300, 301, 640, 480}, {-0.2, 0.6}};
const Parameters eucm{CameraModel::eucm, 1280, 960, {380, 379, 640, 480}, {0.63, 1.05}};
// Typical of the side cameras of KITTI-360: 185 degrees on 1400 x 1400 pixels.
const Parameters mei{CameraModel::mei, 1400, 1400, {1336, 1335.5, 717, 706}, {2.21, 0.017, 1.66, 1.2e-4, 4e-4}};

const std::vector<Parameters> all{rectified, plumb_bob, rational, equidistant, double_sphere, eucm, mei};
const std::vector<Parameters> wide{equidistant, double_sphere, eucm, mei};

/// Evenly over the directions of a sphere, at 0.1 .. 100 m.
class Around {
 public:
  explicit Around(std::uint32_t seed) : random_(seed) {}
  Vector3d point() {
    const Vector3d p(normal_(random_), normal_(random_), normal_(random_));
    return p.normalized() * std::exp(log_range_(random_));
  }

 private:
  std::mt19937 random_;
  std::normal_distribution<double> normal_;
  std::uniform_real_distribution<double> log_range_{-2.3, 4.6};
};

double angle_off_axis(const Vector3d& p) { return std::atan2(p.head<2>().norm(), p.z()); }

using OpenCvPixels = std::vector<cv::Point2d>;
OpenCvPixels opencv(const Parameters& of, const std::vector<cv::Point3d>& points) {
  const auto& f = of.intrinsics;
  const cv::Matx33d K(f[0], 0, f[2], 0, f[1], f[3], 0, 0, 1);
  const auto& d = of.distortion;
  OpenCvPixels pixels;
  if (of.model == CameraModel::equidistant)
    cv::fisheye::projectPoints(points, pixels, cv::Vec3d(), cv::Vec3d(), K, cv::Vec4d(d[0], d[1], d[2], d[3]));
  else if (of.model == CameraModel::mei)
    cv::omnidir::projectPoints(points, pixels, cv::Vec3d(), cv::Vec3d(), K, d[0], cv::Vec4d(d[1], d[2], d[3], d[4]));
  else
    cv::projectPoints(points, cv::Vec3d(), cv::Vec3d(), K, d, pixels);
  return pixels;
}

}  // namespace

TEST_CASE("a rectified camera is a pinhole") {
  const auto uv = rectified.camera().project({2, -1, 10});
  REQUIRE(uv);
  CHECK(uv->x() == Approx(721.5 * 0.2 + 609.6));
  CHECK(uv->y() == Approx(718.2 * -0.1 + 172.9));
}

TEST_CASE("points land where OpenCV puts them") {
  for (const Parameters& of : {rectified, plumb_bob, rational, equidistant, mei}) {
    INFO(to_string(of.model));
    const Camera camera = of.camera();
    Around around(1);
    std::vector<cv::Point3d> points;
    std::vector<Vector2d> pixels;
    while (points.size() < 100'000) {
      const Vector3d p = around.point();
      if (of.model == CameraModel::equidistant && p.z() <= 1e-3) continue;  // OpenCV's fisheye ends at 90 degrees
      if (const auto uv = camera.project(p)) {
        points.emplace_back(p.x(), p.y(), p.z());
        pixels.push_back(*uv);
      }
    }
    const OpenCvPixels expected = opencv(of, points);
    double worst = 0;
    for (std::size_t i = 0; i < points.size(); ++i)
      worst = std::max(worst, (pixels[i] - Vector2d(expected[i].x, expected[i].y)).norm());
    CHECK(worst < 1e-6);
  }
}

TEST_CASE("projecting the bearing of a pixel gives the pixel, all over the image") {
  for (const Parameters& of : all) {
    INFO(to_string(of.model));
    const Camera camera = of.camera();
    std::mt19937 random(2);
    std::uniform_real_distribution<double> u(-0.5, of.width - 0.6), v(-0.5, of.height - 0.6), range(0.5, 100);
    const Vector2d centre(camera.cx(), camera.cy());
    double furthest_seen = 0, nearest_dark = infinity;
    for (int i = 0; i < 20'000; ++i) {
      const Vector2d uv(u(random), v(random));
      const auto bearing = camera.unproject(uv);
      double& radius = bearing ? furthest_seen : nearest_dark;
      radius = bearing ? std::max(radius, (uv - centre).norm()) : std::min(radius, (uv - centre).norm());
      if (!bearing) continue;
      REQUIRE(bearing->norm() == Approx(1).margin(1e-12));
      const auto again = camera.project(*bearing * range(random));
      REQUIRE(again);
      REQUIRE((*again - uv).norm() < 1e-6);
    }
    // The corners of a fisheye's image are dark, outside of a circle (an ellipse: fx is not fy; not quite about its
    // centre: tangential distortion), and nothing else is.
    CHECK(nearest_dark > furthest_seen - 4);
    CHECK(furthest_seen > 0.45 * of.width);
    if (camera.max_angle_rad() < std::numbers::pi / 2) CHECK(nearest_dark == infinity);
  }
}

TEST_CASE("whatever is visible has its bearing back: no pixel is that of another direction") {
  // Beside the lenses above some that fold inside the image, for every reason that there is.
  std::vector<Parameters> lenses = all;
  const std::vector<double> short_lens{200, 200, 800, 800};
  for (const auto& [model, distortion] : std::vector<std::pair<CameraModel, std::vector<double>>>{
           {CameraModel::plumb_bob, {-0.4, 0, 0, 0}},
           {CameraModel::plumb_bob, {-0.3, 0.05, 0.03, -0.05}},
           {CameraModel::plumb_bob, {0.3, 0.1, 0.05, 0.05, -0.1}},
           {CameraModel::rational_polynomial, {0, 0, 0, 0, 0, -0.5, 0, 0}},
           {CameraModel::rational_polynomial, {0.2, 0, 0.01, -0.02, 0, 0.1, 0.3, 0.1}},
           {CameraModel::equidistant, {-0.1, 0, 0, 0}},
           {CameraModel::equidistant, {0, 0, 0, 0}},
           {CameraModel::double_sphere, {-0.9, 0.2}},
           {CameraModel::double_sphere, {0.9, 0.8}},
           {CameraModel::double_sphere, {1, 0.5}},
           {CameraModel::double_sphere, {0.1, 0}},
           {CameraModel::double_sphere, {-0.3, 1}},
           {CameraModel::eucm, {0.3, 2}},
           {CameraModel::eucm, {1, 0.5}},
           {CameraModel::eucm, {0, 1}},
           {CameraModel::mei, {0, -0.4, 0, 0, 0}},
           {CameraModel::mei, {0.8, -0.2, 0.01, 0.02, -0.01}},
           {CameraModel::mei, {1, 0, 0, 0, 0}},
           {CameraModel::mei, {3, -1, 0, 0.01, 0.01}}})
    lenses.push_back({model, 1600, 1600, short_lens, distortion});
  for (const Parameters& of : lenses) {
    INFO(to_string(of.model) << " " << Catch::Detail::stringify(of.distortion));
    const Camera camera = of.camera();
    Around around(3);
    int visible = 0;
    double worst = 0, widest = 0;
    for (int i = 0; i < 100'000; ++i) {
      const Vector3d p = around.point();
      const auto uv = camera.project(p);
      if (!uv) continue;
      ++visible;
      const auto bearing = camera.unproject(*uv);
      REQUIRE(bearing);
      worst = std::max(worst, (*bearing - p.normalized()).norm());
      widest = std::max(widest, angle_off_axis(p));
    }
    CHECK(visible > 1000);
    CHECK(worst < 1e-6);
    CHECK(widest <= camera.max_angle_rad());
  }
}

TEST_CASE("nor with any coefficients at all, up to the very end of what is visible") {
  std::mt19937 random(5);
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> uniform(0, 1);
  for (int i = 0; i < 1400; ++i) {
    Parameters of = all[i % all.size()];
    const double magnitude = std::pow(10, 4 * uniform(random) - 3);
    for (double& d : of.distortion) d = uniform(random) < 0.2 ? 0 : magnitude * normal(random);
    if (of.model == CameraModel::double_sphere) of.distortion = {1 - 2 * uniform(random), uniform(random)};
    if (of.model == CameraModel::eucm) of.distortion = {uniform(random), std::exp(2 * normal(random))};
    if (of.model == CameraModel::mei) of.distortion[0] = 3 * uniform(random);
    of.intrinsics[0] = of.intrinsics[1] = std::exp(3 + 4 * uniform(random));
    INFO(to_string(of.model) << " f " << of.intrinsics[0] << " " << Catch::Detail::stringify(of.distortion));
    const Camera camera = of.camera();
    for (int k = 0; k < 1000; ++k) {
      const double depth_in_cone = k % 10 == 0 ? 2e-6 * uniform(random) : uniform(random) * camera.max_angle_rad();
      const double angle = camera.max_angle_rad() - depth_in_cone, azimuth = 2 * std::numbers::pi * uniform(random);
      const Vector3d b(std::sin(angle) * std::cos(azimuth), std::sin(angle) * std::sin(azimuth), std::cos(angle));
      const auto uv = camera.project(b);
      if (!uv) continue;
      const auto bearing = camera.unproject(*uv);
      REQUIRE(bearing);
      REQUIRE((*bearing - b).norm() < 1e-6);
    }
  }
}

TEST_CASE("a wide lens sees behind itself, as far as its largest angle, and nothing there twice") {
  for (const Parameters& of : wide) {
    INFO(to_string(of.model));
    const Camera camera = of.camera();
    CHECK(camera.project({5, 0, -0.05}));
    double widest = 0;
    for (double azimuth = 0; azimuth < 2 * std::numbers::pi; azimuth += 0.002)
      for (double angle = widest; angle < std::numbers::pi; angle += 1e-3)
        if (camera.project({std::sin(angle) * std::cos(azimuth), std::sin(angle) * std::sin(azimuth), std::cos(angle)}))
          widest = std::max(widest, angle);
    CHECK(widest > 95 * radians_per_degree);
    CHECK(camera.max_angle_rad() >= widest);
    CHECK(camera.max_angle_rad() < widest + 1 * radians_per_degree);
    CHECK_FALSE(camera.project({0, 0, -5}));
    CHECK_FALSE(camera.project({1e-9, 0, -5}));
  }
}

TEST_CASE("the largest angle of a narrow lens is that of its furthest corner") {
  for (const Parameters& of : {rectified, plumb_bob, rational}) {
    const Camera camera = of.camera();
    double widest = 0;
    for (const double u : {0, of.width - 1})
      for (const double v : {0, of.height - 1}) widest = std::max(widest, angle_off_axis(*camera.unproject({u, v})));
    CHECK(camera.max_angle_rad() >= widest);
    CHECK(camera.max_angle_rad() < widest + 0.3 * radians_per_degree);
  }
}

TEST_CASE("a point beyond the fold of the distortion is not visible, although its formula gives a pixel in the image") {
  // r (1 - 0.4 r^2) stops growing at r = 1 / sqrt(1.2) = 0.913 and is back on the axis at r = 1.58.
  const Camera camera =
      test::require_ok(Camera::make(CameraModel::plumb_bob, 1000, 1000, {300, 300, 500, 500}, {-0.4, 0, 0, 0}));
  CHECK(camera.project({0.91, 0, 1}));
  CHECK_FALSE(camera.project({0.92, 0, 1}));
  CHECK_FALSE(camera.project({1.58, 0, 1}));
  CHECK_FALSE(camera.project({0, -1.58, 1}));
  CHECK_FALSE(camera.unproject({500 + 300 * 0.65, 500}));  // the polynomial's largest value is 0.609
  CHECK(camera.max_angle_rad() == Approx(std::atan(1 / std::sqrt(1.2))));
}

TEST_CASE("points in the camera's centre, behind it or not finite are not visible") {
  for (const Parameters& of : all) {
    const Camera camera = of.camera();
    CHECK_FALSE(camera.project({0, 0, -5}));
    CHECK_FALSE(camera.project({0, 0, 0}));
    for (const double bad : {not_a_number, infinity, -infinity})
      for (int i = 0; i < 3; ++i) {
        Vector3d p(0.1, 0.1, 5);
        p[i] = bad;
        CHECK_FALSE(camera.project(p));
        CHECK_FALSE(camera.unproject({bad, 0}));
        CHECK_FALSE(camera.unproject({0, bad}));
      }
  }
  for (const Parameters& of : {rectified, plumb_bob, rational}) CHECK_FALSE(of.camera().project({0.1, 0.1, -5}));
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

TEST_CASE("a resized camera projects a point to where resizing the image moves its pixel") {
  for (const Parameters& of : all) {
    INFO(to_string(of.model));
    const Camera camera = of.camera();
    const Camera small = test::require_ok(camera.resized(of.width / 2, of.height / 3));
    CHECK(small.model() == of.model);
    CHECK(small.width() == of.width / 2);
    CHECK(small.height() == of.height / 3);
    const double x = static_cast<double>(small.width()) / of.width, y = static_cast<double>(small.height()) / of.height;
    const Vector3d p(0.3, -0.1, 2);
    const Vector2d uv = camera.project(p).value(), there = small.project(p).value();
    CHECK(there.x() == Approx((uv.x() + 0.5) * x - 0.5));
    CHECK(there.y() == Approx((uv.y() + 0.5) * y - 0.5));
    CHECK(small.max_angle_rad() == Approx(camera.max_angle_rad()).margin(1e-6));
    CHECK_FALSE(camera.resized(0, 100));
  }
}

TEST_CASE("four distortion parameters mean that k3 is zero") {
  const auto make = [](std::vector<double> distortion) {
    return test::require_ok(Camera::make(CameraModel::plumb_bob, 1242, 375, plumb_bob.intrinsics, distortion));
  };
  CHECK(*make({-0.28, 0.09, 1e-3, 0}).project({3, 1, 10}) == *make({-0.28, 0.09, 1e-3, 0, 0}).project({3, 1, 10}));
}

TEST_CASE("impossible parameters are refused with a sentence") {
  const std::vector<double> f = rectified.intrinsics;
  const std::vector<Parameters> impossible{
      {CameraModel::rectified, 0, 375, f, {}},
      {CameraModel::rectified, 1242, -1, f, {}},
      {CameraModel::rectified, 100'000, 100'000, f, {}},
      {CameraModel::rectified, 1242, 375, {}, {}},
      {CameraModel::rectified, 1242, 375, {700, 700, 600}, {}},
      {CameraModel::rectified, 1242, 375, {0, 700, 600, 170}, {}},
      {CameraModel::rectified, 1242, 375, {700, -700, 600, 170}, {}},
      {CameraModel::rectified, 1242, 375, {700, 1e6, 600, 170}, {}},
      {CameraModel::rectified, 1242, 375, {700, 700, not_a_number, 170}, {}},
      {CameraModel::rectified, 1242, 375, f, {0, 0, 0, 0}},
      {CameraModel::plumb_bob, 1242, 375, f, {}},
      {CameraModel::plumb_bob, 1242, 375, f, {0, 0, 0}},
      {CameraModel::plumb_bob, 1242, 375, f, {0, 0, not_a_number, 0, 0}},
      {CameraModel::rational_polynomial, 1242, 375, f, {0, 0, 0, 0, 0}},
      {CameraModel::equidistant, 1242, 375, f, {0, 0, 0}},
      {CameraModel::double_sphere, 1242, 375, f, {-1, 0.5}},
      {CameraModel::double_sphere, 1242, 375, f, {1.1, 0.5}},
      {CameraModel::double_sphere, 1242, 375, f, {0, 1.1}},
      {CameraModel::double_sphere, 1242, 375, f, {0.5, -0.1}},
      {CameraModel::double_sphere, 1242, 375, f, {0.5}},
      {CameraModel::eucm, 1242, 375, f, {0.5, 0}},
      {CameraModel::eucm, 1242, 375, f, {1.1, 1}},
      {CameraModel::eucm, 1242, 375, f, {-0.1, 1}},
      {CameraModel::mei, 1242, 375, f, {-0.1, 0, 0, 0, 0}},
      {CameraModel::mei, 1242, 375, f, {1336, 0, 0, 0, 0}},
      {CameraModel::mei, 1242, 375, f, {1, 0, 0, 0}},
  };
  for (const Parameters& of : impossible) {
    INFO(to_string(of.model) << " " << Catch::Detail::stringify(of.distortion));
    const auto camera = Camera::make(of.model, of.width, of.height, of.intrinsics, of.distortion);
    REQUIRE_FALSE(camera);
    CHECK(camera.error().code == "bad_camera");
    CHECK_FALSE(camera.error().context.empty());
  }
  CHECK(Camera::make(CameraModel::double_sphere, 640, 480, f, {0.6, -0.2}).error().context ==
        "model double_sphere has alpha = -0.200000, outside 0 <= alpha <= 1; its parameters are, in order, xi, alpha");
}

TEST_CASE("every camera model of the table is tested, has its own name and is read back") {
  std::set<std::string_view> names;
  for (const CameraModelFacts& model : all_camera_models) {
    INFO(model.name);
    CHECK(&facts(model.model) == &model);
    CHECK(names.insert(model.name).second);
    CHECK(to_string(model.model) == model.name);
    CHECK(test::require_ok(parse_camera_model(model.name)) == model.model);
    CHECK(std::ranges::count(all, model.model, &Parameters::model) == 1);
    CHECK(std::ranges::is_partitioned(model.parameters, std::logical_not{}, &camera_models::Parameter::optional));
  }
}

TEST_CASE("each name of CameraInfo's distortion models is one camera model's") {
  std::map<std::string_view, CameraModel> names;
  for (const CameraModelFacts& model : all_camera_models) {
    if (!model.ros) continue;
    for (const std::string_view name : {model.ros->name, model.ros->other_name})
      CHECK(names.emplace(name, model.model).first->second == model.model);
    CHECK(model.ros->takes(model.parameters.size()));
  }
  CHECK(names == std::map<std::string_view, CameraModel>{{"", CameraModel::rectified},
                                                         {"none", CameraModel::rectified},
                                                         {"plumb_bob", CameraModel::plumb_bob},
                                                         {"rational_polynomial", CameraModel::rational_polynomial},
                                                         {"equidistant", CameraModel::equidistant},
                                                         {"fisheye", CameraModel::equidistant}});
}

TEST_CASE("a camera model is known by its name alone") {
  CHECK_FALSE(parse_camera_model(""));
  CHECK_FALSE(parse_camera_model("Rectified"));
  CHECK_THAT(parse_camera_model("\x1b[31m").error().context, !Catch::Matchers::ContainsSubstring("\x1b"));
}
