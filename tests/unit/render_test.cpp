#include "vehicle/render.hpp"

#include <algorithm>
#include <cmath>
#include <opencv2/calib3d.hpp>

#include "support/catch.hpp"
#include "support/support.hpp"
#include "vehicle/rig.hpp"

using namespace calib;
using namespace calib::vehicle;

namespace {

constexpr double times_s[] = {0.0, 11.5, 47.0};

struct Stereo {
  Rendering left, right;
};

Stereo render_stereo(Scene& scene, const Rig& rig, double t_s) {
  const auto instances = scene.instances(t_s);
  const RigidTransform T_world_left = scene.T_world_vehicle(t_s) * rig.T_vehicle_camera;
  const RigidTransform T_world_right = T_world_left * Eigen::Translation3d(rig.baseline_m, 0, 0);
  return {render(scene, instances, rig.camera, T_world_left), render(scene, instances, rig.camera, T_world_right)};
}

cv::Mat as_mat(Image& image) { return {image.height, image.width, CV_8UC1, image.pixels.data()}; }

}  // namespace

TEST_CASE("a street without anything in it is sky") {
  const Scene scene(1);
  const Rig rig = test::require_ok(Rig::make(320, 96));
  const Rendering empty = render(scene, {}, rig.camera, rig.T_vehicle_camera);
  CHECK(std::ranges::all_of(empty.depth_m, [](float depth) { return std::isinf(depth); }));
  CHECK(std::ranges::all_of(empty.brightness, [](float value) { return value > 0.3f && value < 1.5f; }));
}

TEST_CASE("the ground has no holes and the sky is above") {
  Scene scene(3);
  const Rig rig = test::require_ok(Rig::make(960, 288));
  for (const double t_s : times_s) {
    const Rendering left = render_stereo(scene, rig, t_s).left;
    // From 6 degrees below the horizon down there is street everywhere.
    const int below = static_cast<int>(rig.camera.cy() + 0.1 * rig.camera.fy()) * left.width;
    CHECK(std::all_of(left.depth_m.begin() + below, left.depth_m.end(), [](float depth) { return depth < 60; }));
    CHECK(std::count_if(left.depth_m.begin(), left.depth_m.end(), [](float depth) { return std::isinf(depth); }) > 500);
  }
}

TEST_CASE("a place is at f B / z further left in the right image, and as bright there") {
  Scene scene(4);
  const Rig rig = test::require_ok(Rig::make(960, 288));
  const double f_B = rig.camera.fx() * rig.baseline_m;
  for (const double t_s : times_s) {
    const auto [left, right] = render_stereo(scene, rig, t_s);
    int compared = 0, same_depth = 0, too_far = 0, same_brightness = 0;
    for (int y = 0; y < left.height; ++y)
      for (int x = 0; x < left.width; ++x) {
        const float depth = left.depth_m[y * left.width + x];
        const double there = x - f_B / depth;
        if (std::isinf(depth) || there < 0 || there > left.width - 2) continue;
        // Between two pixels of the row 1/z and brightness are taken to be linear.
        const int i = y * left.width + static_cast<int>(there);
        const double share = there - std::floor(there);
        const double inverse = (1 - share) / right.depth_m[i] + share / right.depth_m[i + 1];
        ++compared;
        too_far += inverse * depth < 0.98;
        if (std::abs(inverse * depth - 1) > 0.02) continue;
        ++same_depth;
        const double brightness = (1 - share) * right.brightness[i] + share * right.brightness[i + 1];
        same_brightness += std::abs(brightness - left.brightness[y * left.width + x]) < 0.05;
      }
    REQUIRE(compared > 100'000);
    CHECK(same_depth > 0.88 * compared);  // most of the rest is hidden from the right camera by something nearer
    CHECK(too_far < 0.02 * compared);     // beside an edge only
    CHECK(same_brightness > 0.95 * same_depth);
  }
}

TEST_CASE("semi-global matching finds the rendered depth below the horizon") {
  Scene scene(5);
  const Rig rig = test::require_ok(Rig::make(960, 288));
  for (const double t_s : times_s) {
    const auto [left, right] = render_stereo(scene, rig, t_s);
    Image left_image = expose(left, 0.9f, 1), right_image = expose(right, 0.9f, 2);
    const auto matcher = cv::StereoSGBM::create(0, 128, 5, 200, 800, 1, 0, 10, 100, 2);
    cv::Mat disparity;  // sixteenths of a pixel; not positive where there is none
    matcher->compute(as_mat(left_image), as_mat(right_image), disparity);
    std::vector<double> relative_errors;
    int below_horizon = 0;
    for (int y = static_cast<int>(rig.camera.cy()) + 5; y < left.height; ++y)
      for (int x = 128; x < left.width; ++x) {
        ++below_horizon;
        const float depth = left.depth_m[y * left.width + x];
        const double found = disparity.at<std::int16_t>(y, x) / 16.0;
        if (found > 0) relative_errors.push_back(std::abs(rig.camera.fx() * rig.baseline_m / found / depth - 1));
      }
    CHECK(static_cast<double>(relative_errors.size()) >= 0.6 * below_horizon);
    const auto middle = relative_errors.begin() + static_cast<std::ptrdiff_t>(relative_errors.size() / 2);
    std::nth_element(relative_errors.begin(), middle, relative_errors.end());
    CHECK(*middle <= 0.03);
  }
}

TEST_CASE("the sensor's noise depends on its key and is small") {
  Scene scene(6);
  const Rig rig = test::require_ok(Rig::make(320, 96));
  const Rendering left = render_stereo(scene, rig, 3).left;
  const Image first = expose(left, 0.9f, 10), again = expose(left, 0.9f, 10), other = expose(left, 0.9f, 11);
  CHECK(first.pixels == again.pixels);
  CHECK(first.pixels != other.pixels);
  double square_sum = 0;
  for (std::size_t i = 0; i < first.pixels.size(); ++i) square_sum += std::pow(first.pixels[i] - other.pixels[i], 2);
  const double sigma = std::sqrt(square_sum / static_cast<double>(first.pixels.size()) / 2);
  CHECK(sigma > 0.8);
  CHECK(sigma < 2);
}
