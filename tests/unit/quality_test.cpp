#include "calib/quality.hpp"

#include <functional>
#include <limits>

#include "support/catch.hpp"
#include "support/support.hpp"
#include "vehicle/random.hpp"

using namespace calib;

namespace {

constexpr int width = 240, height = 96;

Camera camera() { return test::require_ok(Camera::make(CameraModel::rectified, width, height, {200, 200, 120, 48})); }

FramePair pair_of(const std::function<int(int, int)>& grey, std::size_t points = 5000) {
  FramePair pair{.image = {{}, width, height, {}}, .right_image = {}, .scan = {}};
  for (int v = 0; v < height; ++v)
    for (int u = 0; u < width; ++u) pair.image.pixels.push_back(static_cast<std::uint8_t>(grey(u, v)));
  pair.scan.points.resize(points, {10, 0, 0, 0});
  return pair;
}

/// Blocks of chance brightness: enough of a street for these checks.
int street(int u, int v) { return 60 + static_cast<int>(vehicle::mix(u / 12, v / 12) % 120); }

std::string refusal(const FramePair& pair, const SceneThumbnail* last = nullptr) {
  const auto result = check_pair(pair, camera(), last, {});
  return result ? "" : word(result.error().code);
}

}  // namespace

TEST_CASE("a street by day passes, and each thing that is wrong with a pair has its own word") {
  CHECK(refusal(pair_of(street)).empty());
  CHECK(refusal(pair_of([](int u, int v) { return street(u, v) / 12; })) == "dark");
  CHECK(refusal(pair_of([](int u, int v) { return u < width / 2 ? 255 : street(u, v); })) == "saturated");
  CHECK(refusal(pair_of([](int u, int v) { return 100 + street(u, v) / 60; })) == "low_texture");
  CHECK(refusal(pair_of(street, 0)) == "low_overlap");
  CHECK(refusal(pair_of(street, 999)) == "low_overlap");

  FramePair turned = pair_of(street);
  std::swap(turned.image.width, turned.image.height);
  CHECK(refusal(turned) == "image_size_mismatch");
  FramePair none = pair_of(street);
  none.image = {};
  CHECK(refusal(none) == "image_size_mismatch");
}

TEST_CASE("every refusal names the value and its limit") {
  const auto dark = check_pair(pair_of([](int, int) { return 7; }), camera(), nullptr, {});
  REQUIRE_FALSE(dark);
  CHECK_THAT(dark.error().context,
             Catch::Matchers::ContainsSubstring("7.00") && Catch::Matchers::ContainsSubstring("20.00"));
}

TEST_CASE("a pair is refused when the vehicle turns too far between image and scan, where its turn rate is known") {
  using namespace std::chrono_literals;
  constexpr double deg = radians_per_degree;
  FramePair pair = pair_of(street);
  const auto turning = [&](std::chrono::nanoseconds difference, double rate_deg_s) {
    pair.scan.stamp = pair.image.stamp + difference;
    pair.turn_rate_rad_s = rate_deg_s * deg;
    return refusal(pair);
  };
  CHECK(turning(50ms, 10) == "motion");
  CHECK(turning(-50ms, 10) == "motion");
  CHECK(turning(50ms, 1.99).empty());
  CHECK(turning(50ms, 2.01) == "motion");
  CHECK(turning(9ms, 10).empty());
  CHECK(turning(0ms, 90).empty());
  CHECK(turning(50ms, 0).empty());
  pair.scan.stamp = pair.image.stamp + 50ms;
  pair.turn_rate_rad_s = 10 * deg;
  CHECK(check_pair(pair, camera(), nullptr, {.max_turn_rad = 0.6 * deg}));
  CHECK_THAT(check_pair(pair, camera(), nullptr, {}).error().context,
             Catch::Matchers::ContainsSubstring("degrees is 0.50, the limit is 0.10"));
  pair.turn_rate_rad_s.reset();
  CHECK(refusal(pair).empty());
}

TEST_CASE("a standing vehicle is distinguished from a moving one, whatever the noise and the order") {
  const FramePair here = pair_of(street);
  const FramePair noisy =
      pair_of([](int u, int v) { return street(u, v) + static_cast<int>(vehicle::mix(u, v) % 21) - 10; });
  const FramePair ahead = pair_of([](int u, int v) { return street(u + 12, v); });
  const SceneThumbnail was_here = thumbnail(here.image), was_ahead = thumbnail(ahead.image);
  CHECK(refusal(here, &was_here) == "standing_still");
  CHECK(refusal(noisy, &was_here) == "standing_still");
  CHECK(refusal(ahead, &was_here).empty());
  CHECK(refusal(here, &was_ahead).empty());
}

TEST_CASE("a thumbnail is small and the same size for every image") {
  const Image tiny{{}, 3, 2, std::vector<std::uint8_t>(6, 9)};
  CHECK(thumbnail(tiny).grey.size() == thumbnail(pair_of(street).image).grey.size());
  CHECK(thumbnail(Image{}).grey == std::vector<std::uint8_t>(thumbnail(tiny).grey.size(), 0));
}

TEST_CASE("depth is good from the limit on, and values that are no depth do not count") {
  DepthMap depth{10, 10, std::vector<float>(100, DepthMap::no_depth)};
  for (int i = 0; i < 14; ++i) depth.inverse_depth[i] = 0.1F;
  for (int i = 20; i < 60; ++i) depth.inverse_depth[i] = std::numeric_limits<float>::quiet_NaN();
  CHECK(check_depth(depth, {}).error().code == "few_valid_depth");
  depth.inverse_depth[14] = 0.1F;
  CHECK(check_depth(depth, {}));
  CHECK(check_depth(DepthMap{}, {}).error().code == "few_valid_depth");
}

TEST_CASE("depth out of range, and of places that are blown out or drowned, is masked; everything else stays") {
  FramePair pair = pair_of(street);
  DepthMap depth{width, height, std::vector<float>(width * height, 0.1F)};
  const auto paint = [&](int u0, int v0, int size, std::uint8_t grey) {
    for (int v = v0; v < v0 + size; ++v)
      for (int u = u0; u < u0 + size; ++u) pair.image.pixels[v * width + u] = grey;
  };
  paint(20, 20, 20, 255);
  paint(60, 20, 20, 0);
  paint(100, 20, 3, 255);  // a lamp: its depth is known from around it
  depth.inverse_depth[0] = 3;
  depth.inverse_depth[1] = 0.004F;
  depth.inverse_depth[2] = std::numeric_limits<float>::quiet_NaN();
  depth.inverse_depth[3] = DepthMap::no_depth;
  DepthMap masked = depth;
  test::require_ok(mask_depth(pair.image, {0.5, 200}, masked));
  for (const int i : {0, 1, 2, 3}) CHECK(masked.inverse_depth[i] == DepthMap::no_depth);
  const auto at = [&](int u, int v) { return masked.inverse_depth[v * width + u]; };
  CHECK((at(30, 30) == 0 && at(70, 30) == 0));
  CHECK((at(20, 20) > 0 && at(101, 21) > 0));  // the border of what is blown out still has an edge to go by
  CHECK(masked.valid_share() == Approx(1 - (4 + 2 * 16 * 16) / double{width * height}));

  DepthMap relative = depth;
  test::require_ok(mask_depth(pair_of(street).image, {}, relative));
  CHECK((relative.inverse_depth[0] == 3 && relative.inverse_depth[1] == 0.004F));
}

TEST_CASE("depth that is not of its image's size is refused, and stays as it is") {
  const FramePair pair = pair_of(street);
  const std::vector<float> values(width * (height - 1), 7.0F);
  DepthMap depth{width, height - 1, values};
  CHECK(mask_depth(pair.image, {0.5, 200}, depth).error().code == "image_size_mismatch");
  CHECK(depth.inverse_depth == values);
}
