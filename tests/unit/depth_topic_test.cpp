#include "calib/depth_topic.hpp"

#include <algorithm>
#include <numeric>

#include "support/catch.hpp"
#include "support/support.hpp"

using namespace calib;

namespace {

constexpr int width = 64, height = 32;

Camera pinhole(int w, int h, double f) {
  return test::require_ok(Camera::make(CameraModel::rectified, w, h, {f, f, (w - 1) / 2.0, (h - 1) / 2.0}));
}

FramePair with_depth(int w, int h, std::vector<float> inverse_depth) {
  FramePair pair{
      .image = {{}, width, height, std::vector<std::uint8_t>(width * height)}, .right_image = {}, .scan = {}};
  pair.depth = DepthImage{{}, w, h, std::move(inverse_depth)};
  return pair;
}

std::vector<float> ramp(int w, int h) {
  std::vector<float> values(static_cast<std::size_t>(w) * h);
  std::iota(values.begin(), values.end(), 1.0F);
  return values;
}

std::vector<float> inverse_depth(const std::optional<DepthCamera>& own, const FramePair& pair) {
  return test::require_ok(make_topic_depth(pinhole(width, height, 50), own)->estimate(pair)).inverse_depth;
}

/// The pixels that hold `value`: columns and rows from .. to, and whether they fill that.
struct Patch {
  int left = width, top = height, right = -1, bottom = -1, count = 0;
};
Patch patch_of(const std::vector<float>& depth, float value) {
  Patch patch;
  for (int v = 0; v < height; ++v)
    for (int u = 0; u < width; ++u)
      if (depth[v * width + u] == Approx(value)) {
        patch = {std::min(patch.left, u), std::min(patch.top, v), std::max(patch.right, u), std::max(patch.bottom, v),
                 patch.count + 1};
      }
  return patch;
}

}  // namespace

TEST_CASE("depth of the image's size is taken as it is, of another size from the nearest pixel") {
  CHECK(inverse_depth({}, with_depth(width, height, ramp(width, height))) == ramp(width, height));
  const auto coarse = ramp(width / 4, height / 4);
  const auto wide = inverse_depth({}, with_depth(width / 4, height / 4, coarse));
  for (int v = 0; v < height; ++v)
    for (int u = 0; u < width; ++u) REQUIRE(wide[v * width + u] == coarse[v / 4 * (width / 4) + u / 4]);
  const auto fine = inverse_depth({}, with_depth(width * 3, height * 3, ramp(width * 3, height * 3)));
  CHECK(fine[0] == ramp(width * 3, height * 3)[width * 3 + 1]);  // the middle one of nine
}

TEST_CASE("depth that is not there, of no size or of another shape is refused") {
  FramePair none = with_depth(width, height, {});
  const auto estimator = make_topic_depth(pinhole(width, height, 50), {});
  CHECK(estimator->estimate(none).error().code == "depth_failed");
  none.depth.reset();
  CHECK(estimator->estimate(none).error().code == "depth_failed");
  CHECK_THAT(estimator->estimate(with_depth(0, 0, {})).error().context,
             Catch::Matchers::ContainsSubstring("no pixels"));
  CHECK_THAT(estimator->estimate(with_depth(40, 30, ramp(40, 30))).error().context,
             Catch::Matchers::ContainsSubstring("own intrinsics"));
  const auto own = make_topic_depth(pinhole(width, height, 50), DepthCamera{pinhole(40, 30, 50), {}});
  CHECK_THAT(own->estimate(with_depth(30, 40, ramp(30, 40))).error().context,
             Catch::Matchers::ContainsSubstring("40 x 30"));
}

TEST_CASE("a depth camera in the camera's place shows the same; one beside it, shifted by what it sees") {
  const DepthCamera same{pinhole(width, height, 50), RigidTransform::Identity()};
  const auto picture = ramp(width, height);
  const auto again = inverse_depth(same, with_depth(width, height, picture));
  for (std::size_t i = 0; i < again.size(); ++i) REQUIRE(again[i] == Approx(picture[i]));

  // 0.1 m to the camera's left: what is 2.5 m away is seen 2 pixels further right in its picture than in the camera's.
  DepthCamera beside = same;
  beside.T_camera_depth = RigidTransform(Eigen::Translation3d(-0.1, 0, 0));
  std::vector<float> point(width * height);
  point[10 * width + 30] = 0.4F;
  const Patch patch = patch_of(inverse_depth(beside, with_depth(width, height, point)), 0.4F);
  CHECK((patch.left == 28 && patch.right == 28 && patch.top == 10 && patch.bottom == 10));
}

TEST_CASE(
    "of two surfaces that fall on one pixel the nearer is seen, whatever their order, and what nobody saw is a hole") {
  DepthCamera beside{pinhole(width, height, 50), RigidTransform(Eigen::Translation3d(-0.1, 0, 0))};
  for (const bool near_first : {true, false}) {
    std::vector<float> two(width * height);
    two[5 * width + (near_first ? 24 : 40)] = near_first ? 0.8F : 0.2F;  // 4 and 1 pixels of shift
    two[5 * width + (near_first ? 21 : 43)] = near_first ? 0.2F : 0.8F;
    two[5 * width + 40] = 0.2F;
    two[5 * width + 43] = 0.8F;
    const auto depth = inverse_depth(beside, with_depth(width, height, two));
    CHECK(depth[5 * width + 39] == Approx(0.8F));
    CHECK(std::ranges::count_if(depth, [](float value) { return value > 0; }) <= 3);
  }
}

TEST_CASE("a coarser depth camera covers as many pixels as its own are wide, and points behind the camera none") {
  DepthCamera coarse{pinhole(width / 2, height / 2, 25), RigidTransform::Identity()};
  const auto full =
      inverse_depth(coarse, with_depth(width / 2, height / 2, std::vector<float>(width * height / 4, 0.5F)));
  CHECK(std::ranges::all_of(full, [](float value) { return value == Approx(0.5F); }));
  coarse.T_camera_depth = RigidTransform(Eigen::Translation3d(0, 0, -10));
  const auto behind =
      inverse_depth(coarse, with_depth(width / 2, height / 2, std::vector<float>(width * height / 4, 0.5F)));
  CHECK(std::ranges::all_of(behind, [](float value) { return value == 0; }));
}
