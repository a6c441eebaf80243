#include "calib/depth_stereo.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "support/catch.hpp"
#include "support/support.hpp"
#include "vehicle/random.hpp"

using namespace calib;

namespace {

constexpr int width = 320, height = 96;
constexpr double focal = 200, baseline_m = 0.5;

Camera camera(CameraModel model = CameraModel::rectified) {
  return test::require_ok(
      Camera::make(model, width, height, {focal, focal, width / 2, height / 2},
                   model == CameraModel::plumb_bob ? std::vector<double>{-0.1, 0, 0, 0} : std::vector<double>{}));
}

/// A textured wall, of which the pixel (u, v) of the left image is found `disparity(v)` pixels to the left in the right
/// image.
template <typename Disparity>
FramePair wall(Disparity disparity) {
  FramePair pair{.image = {{}, width, height, {}}, .right_image = Image{{}, width, height, {}}, .scan = {}};
  const auto grey = [](int u, int v) { return static_cast<std::uint8_t>(vehicle::mix(u + 1000, v) % 200 + 20); };
  for (int v = 0; v < height; ++v)
    for (int u = 0; u < width; ++u) {
      pair.image.pixels.push_back(grey(u, v));
      pair.right_image->pixels.push_back(grey(u + disparity(v), v));
    }
  return pair;
}

DepthMap depth_of(const FramePair& pair, double baseline = baseline_m) {
  return test::require_ok(test::require_ok(make_stereo_depth(camera(), baseline))->estimate(pair));
}

}  // namespace

TEST_CASE("walls at any distance in range have the inverse depth of their disparity, in 1/m") {
  for (const int far : {1, 3, 8, 14}) {
    const int near = far + 10;
    const DepthMap depth = depth_of(wall([&](int v) { return v < height / 2 ? far : near; }));
    REQUIRE(depth.width == width);
    REQUIRE(depth.height == height);
    int right = 0, wrong = 0;
    for (int v = 0; v < height; ++v) {
      if (std::abs(v - height / 2) < 4) continue;  // the matching window sees both
      const double expected = (v < height / 2 ? far : near) / (focal * baseline_m);
      for (int u = 40; u < width; ++u) {
        const float found = depth.inverse_depth[v * width + u];
        if (found == DepthMap::no_depth) continue;
        (std::abs(found - expected) < 0.25 / (focal * baseline_m) ? right : wrong)++;
      }
    }
    CHECK(right > 0.9 * (width - 40) * (height - 8));
    CHECK(wrong < 0.01 * right);
  }
}

// Physics: the wall is seen by cameras of four times as many pixels in each direction, and one row and one column more,
// which are matched at half their size. Its grey is interpolated between points three pixels apart.
// Bound: as for coarse images, a quarter of a pixel of the image at half its size; half of one where the disparity is
// odd, because matching prefers whole pixels.
TEST_CASE("of fine images, which are matched at half their size, each pixel has the depth of its disparity") {
  constexpr int fine_width = 4 * width + 1, fine_height = 4 * height + 1;
  constexpr double fine_focal = 4 * focal;
  const Camera fine = test::require_ok(Camera::make(CameraModel::rectified, fine_width, fine_height,
                                                    {fine_focal, fine_focal, fine_width / 2.0, fine_height / 2.0}));
  const auto estimator = test::require_ok(make_stereo_depth(fine, baseline_m));
  const auto grey = [](int u, int v) {
    double value = 0;
    for (const auto& [i, j] : {std::pair{0, 0}, {1, 0}, {0, 1}, {1, 1}})
      value += std::abs(1 - i - u % 3 / 3.0) * std::abs(1 - j - v % 3 / 3.0) *
               static_cast<double>(vehicle::mix(u / 3 + i + 1000, v / 3 + j) % 200);
    return static_cast<std::uint8_t>(20 + value);
  };
  for (const int far : {4, 13, 30}) {
    const int near = far + 40;
    const double bound = far % 2 == 0 ? 0.5 : 1;
    const auto disparity = [&](int v) { return v < fine_height / 2 ? far : near; };
    FramePair pair{
        .image = {{}, fine_width, fine_height, {}}, .right_image = Image{{}, fine_width, fine_height, {}}, .scan = {}};
    for (int v = 0; v < fine_height; ++v)
      for (int u = 0; u < fine_width; ++u) {
        pair.image.pixels.push_back(grey(u, v));
        pair.right_image->pixels.push_back(grey(u + disparity(v), v));
      }
    const DepthMap depth = test::require_ok(estimator->estimate(pair));
    REQUIRE(depth.inverse_depth.size() == pair.image.pixels.size());
    int right = 0, wrong = 0;
    for (int v = 0; v < fine_height; ++v) {
      if (std::abs(v - fine_height / 2) < 16) continue;  // the matching window sees both
      const double expected = disparity(v) / (fine_focal * baseline_m);
      for (int u = 160; u < fine_width; ++u) {
        const float found = depth.inverse_depth[v * fine_width + u];
        if (found == DepthMap::no_depth) continue;
        (std::abs(found - expected) < bound / (fine_focal * baseline_m) ? right : wrong)++;
      }
    }
    CHECK(right > 0.9 * (fine_width - 160) * (fine_height - 32));
    CHECK(wrong < 0.01 * right);
  }
}

TEST_CASE("cameras twice as far apart see the same disparity twice as far away") {
  const FramePair pair = wall([](int) { return 6; });
  const DepthMap once = depth_of(pair, 0.25), twice = depth_of(pair, 0.5);
  for (std::size_t i = 0; i < once.inverse_depth.size(); ++i)
    REQUIRE(once.inverse_depth[i] == Approx(2 * twice.inverse_depth[i]));
  CHECK(once.valid_share() > 0.8);
}

TEST_CASE("what is infinitely far or has nothing in common has no depth, and no depth is never negative") {
  CHECK(depth_of(wall([](int) { return 0; })).valid_share() == 0);
  FramePair strangers = wall([](int) { return 5; });
  for (std::size_t i = 0; i < strangers.right_image->pixels.size(); ++i)
    strangers.right_image->pixels[i] = static_cast<std::uint8_t>(vehicle::mix(77, i) % 256);
  const DepthMap depth = depth_of(strangers);
  CHECK(depth.valid_share() < 0.1);
  CHECK(std::ranges::all_of(depth.inverse_depth, [](float value) { return value >= 0 && std::isfinite(value); }));
  CHECK(DepthMap{}.valid_share() == 0);
}

TEST_CASE("block matching finds the wall too, where it is textured") {
  const auto matcher =
      test::require_ok(make_stereo_depth(camera(), rectified_right_camera(camera(), baseline_m), StereoMatcher::bm));
  const DepthMap depth = test::require_ok(matcher->estimate(wall([](int) { return 8; })));
  CHECK(depth.valid_share() > 0.6);
  for (const float inverse : depth.inverse_depth)
    if (inverse > 0) REQUIRE(inverse == Approx(8 / (focal * baseline_m)).epsilon(0.05));
  FramePair grey = wall([](int) { return 8; });
  grey.image.pixels.assign(grey.image.pixels.size(), 90);
  grey.right_image->pixels = grey.image.pixels;
  CHECK(test::require_ok(matcher->estimate(grey)).valid_share() < 0.05);
}

// Physics: two lenses that bend, turned a few degrees against each other and not at the same height, look at a slanted
// wall 3 .. 8 m away, painted with chance grey.
// Bound: half of the left image's pixels get depth; nine in ten of those are right to 5 %.
TEST_CASE("depth of an unrectified pair is along the left camera's own axis, at its own pixels") {
  const int size_u = 400, size_v = 240;
  const std::pair<CameraModel, std::vector<double>> lenses[] = {
      {CameraModel::plumb_bob, {-0.28, 0.07, 0.0005, -0.0003, 0}},
      {CameraModel::rational_polynomial, {0.5, -0.1, 0.0004, 0.0002, 0.01, 0.8, 0.05, 0.01}},
      {CameraModel::equidistant, {0.01, -0.004, 0.001, 0}},
      {CameraModel::double_sphere, {-0.2, 0.55}},
      {CameraModel::rectified, {}}};
  Vector6 turn;
  turn << 0.02, -0.03, 0.015, 0, 0, 0;
  RightCamera right{camera(), perturbation(turn)};
  right.T_right_left.translation() = Eigen::Vector3d(-0.4, 0.02, 0.03);
  const Eigen::Vector3d normal = Eigen::Vector3d(0.5, 0.1, -1).normalized();
  constexpr double offset_m = -4;  // of the wall: points with normal . p = offset
  const auto paint = [](const Eigen::Vector3d& p) {
    const double x = p.x() * 60, y = p.y() * 60, column = std::floor(x), row = std::floor(y);
    double value = 0;
    for (const auto& [i, j] : {std::pair{0, 0}, {1, 0}, {0, 1}, {1, 1}}) {
      const auto chance =
          vehicle::mix(static_cast<std::uint64_t>(column + i + 1e6), static_cast<std::uint64_t>(row + j + 1e6));
      value +=
          (i != 0 ? x - column : 1 - x + column) * (j != 0 ? y - row : 1 - y + row) * static_cast<double>(chance % 200);
    }
    return static_cast<std::uint8_t>(20 + value);
  };
  for (const auto& [model, distortion] : lenses) {
    INFO(to_string(model));
    const Camera left = test::require_ok(Camera::make(model, size_u, size_v, {220, 222, 203, 118}, distortion));
    right.camera = test::require_ok(Camera::make(model, size_u, size_v, {215, 216, 196, 122}, distortion));
    std::vector<double> depth_m;
    const auto look = [&](const Camera& lens, const RigidTransform& T_left_lens, bool with_depth) {
      Image image{{}, size_u, size_v, {}};
      for (int v = 0; v < size_v; ++v)
        for (int u = 0; u < size_u; ++u) {
          const Eigen::Vector3d bearing = lens.unproject(Eigen::Vector2d(u, v)).value_or(Eigen::Vector3d::Zero());
          const double along = normal.dot(T_left_lens.linear() * bearing);
          const double range = along < -1e-3 ? (offset_m - normal.dot(T_left_lens.translation())) / along : 0;
          image.pixels.push_back(range > 0 ? paint(T_left_lens * (range * bearing)) : 0);
          if (with_depth) depth_m.push_back(range * bearing.z());
        }
      return image;
    };
    FramePair pair{.image = look(left, RigidTransform::Identity(), true),
                   .right_image = look(right.camera, right.T_right_left.inverse(), false),
                   .scan = {}};
    const auto estimator = test::require_ok(make_stereo_depth(left, right));
    const DepthMap depth = test::require_ok(estimator->estimate(pair));
    REQUIRE(depth.inverse_depth.size() == depth_m.size());
    int found = 0, good = 0;
    for (std::size_t i = 0; i < depth_m.size(); ++i)
      if (depth.inverse_depth[i] > 0) {
        ++found;
        good += std::abs(depth.inverse_depth[i] * depth_m[i] - 1) < 0.05;
      }
    CHECK(2 * found > static_cast<int>(depth_m.size()));
    CHECK(good > 0.9 * found);
  }
}

TEST_CASE("the refusal of two cameras that are no stereo pair names what is wrong with them") {
  const auto refusal = [](const RigidTransform& T_right_left) {
    const auto made = make_stereo_depth(camera(CameraModel::plumb_bob), {camera(CameraModel::plumb_bob), T_right_left});
    return made ? "" : made.error().context;
  };
  const auto at = [](double x, double y, double z, double yaw_rad = 0) {
    return RigidTransform(Eigen::Translation3d(x, y, z) * Eigen::AngleAxisd(yaw_rad, Eigen::Vector3d::UnitY()));
  };
  CHECK(refusal(at(-0.5, 0, 0)).empty());
  CHECK_THAT(refusal(at(0.5, 0, 0)), Catch::Matchers::ContainsSubstring("changed places"));
  CHECK_THAT(refusal(at(0, -0.5, 0)), Catch::Matchers::ContainsSubstring("changed places"));
  CHECK_THAT(refusal(at(-540, 0, 0)), Catch::Matchers::ContainsSubstring("in metres"));
  CHECK_THAT(refusal(at(-0.5, 0, 0, 0.7)), Catch::Matchers::ContainsSubstring("look the same way"));
  CHECK_THAT(refusal(at(std::nan(""), 0, 0)), Catch::Matchers::ContainsSubstring("0.001 .. 10 m"));
}

TEST_CASE("a pair without its right image, or with one of another size, has no depth") {
  const auto estimator = test::require_ok(make_stereo_depth(camera(), baseline_m));
  FramePair pair = wall([](int) { return 5; });
  pair.right_image->width = height;
  pair.right_image->height = width;
  CHECK(estimator->estimate(pair).error().code == "depth_failed");
  pair.right_image.reset();
  CHECK(estimator->estimate(pair).error().code == "depth_failed");
}

TEST_CASE("no stereo depth is made of cameras that cannot give it") {
  for (const double impossible :
       {0.0, -0.5, 11.0, std::numeric_limits<double>::infinity(), std::numeric_limits<double>::quiet_NaN()})
    CHECK(make_stereo_depth(camera(), impossible).error().code == "bad_camera");
  CHECK(make_stereo_depth(camera(CameraModel::plumb_bob), baseline_m).error().code == "bad_camera");
}
