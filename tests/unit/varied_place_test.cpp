#include "vehicle/varied_place.hpp"

#include <algorithm>
#include <cmath>
#include <set>

#include "support/catch.hpp"

using namespace calib;
using namespace calib::vehicle;

namespace {

constexpr int width = 160, height = 64;

const NoiseTexture& noise() {
  static const NoiseTexture texture(1);
  return texture;
}

/// Mean depth of a row's solid pixels; infinite where there are none.
float mean_depth(const Rendering& rendering, int row) {
  float sum = 0;
  int count = 0;
  for (int x = 0; x < width; ++x)
    if (const float depth = rendering.depth_m[row * width + x]; std::isfinite(depth)) sum += depth, ++count;
  return count > 0 ? sum / static_cast<float>(count) : INFINITY;
}

}  // namespace

TEST_CASE("a varied view depends on seed and index alone") {
  const VariedView once = varied_view(noise(), 7, 3, width, height), again = varied_view(noise(), 7, 3, width, height);
  CHECK(once.image.pixels == again.image.pixels);
  CHECK(once.rendering.depth_m == again.rendering.depth_m);
  CHECK(varied_view(noise(), 7, 4, width, height).image.pixels != once.image.pixels);
  CHECK(varied_view(noise(), 8, 3, width, height).image.pixels != once.image.pixels);
}

TEST_CASE("varied views show what a depth network has to know") {
  int nearer_below = 0, with_sky = 0;
  float narrowest = 180, widest = 0;
  std::set<int> brightness;
  constexpr int count = 24;
  for (int i = 0; i < count; ++i) {
    const VariedView view = varied_view(noise(), 11, i, width, height);
    const auto& depth = view.rendering.depth_m;
    CHECK(std::ranges::all_of(depth, [](float z) { return z > 0; }));
    nearer_below += mean_depth(view.rendering, height - 1) < mean_depth(view.rendering, height / 2);
    with_sky += std::ranges::any_of(depth, [](float z) { return std::isinf(z); });
    const auto across = static_cast<float>(2 * std::atan(0.5 * width / view.camera.fx()) * 180 / M_PI);
    narrowest = std::min(narrowest, across), widest = std::max(widest, across);
    long sum = 0;
    for (const std::uint8_t pixel : view.image.pixels) sum += pixel;
    brightness.insert(static_cast<int>(sum / static_cast<long>(view.image.pixels.size())));
  }
  CHECK(nearer_below > count * 2 / 3);
  CHECK(with_sky > count / 2);
  CHECK(narrowest < 60);
  CHECK(widest > 90);
  CHECK(*brightness.rbegin() - *brightness.begin() > 60);
}
