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
  return test::require_ok(Camera::make(model, width, height, {focal, focal, width / 2, height / 2},
                                       model == CameraModel::plumb_bob ? std::vector<double>{-0.1, 0, 0, 0}
                                                                       : std::vector<double>{}));
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
