// The network that calibd brings: proves itself, ranks depth on pictures that it has never seen, and on real ones.
#include <algorithm>
#include <cmath>
#include <numeric>

#include "calib/depth_onnx.hpp"
#include "dataset/depth_files.hpp"
#include "dataset/recording.hpp"
#include "support/catch.hpp"
#include "support/support.hpp"
#include "vehicle/rig.hpp"
#include "vehicle/varied_place.hpp"

using namespace calib;
using test::require_ok;

namespace {

const std::filesystem::path descriptor = CALIBD_STREET_MODEL;

/// Mean rank of each value among all.
std::vector<double> ranks(const std::vector<float>& values) {
  std::vector<std::size_t> order(values.size());
  std::iota(order.begin(), order.end(), 0);
  std::ranges::sort(order, {}, [&](std::size_t i) { return values[i]; });
  std::vector<double> result(values.size());
  for (std::size_t begin = 0; begin < order.size();) {
    std::size_t end = begin;
    while (end < order.size() && values[order[end]] == values[order[begin]]) ++end;
    for (std::size_t i = begin; i < end; ++i) result[order[i]] = 0.5 * static_cast<double>(begin + end - 1);
    begin = end;
  }
  return result;
}

double spearman(const std::vector<float>& a, const std::vector<float>& b) {
  const auto x = ranks(a), y = ranks(b);
  const double mean = 0.5 * static_cast<double>(x.size() - 1);
  double xy = 0, xx = 0, yy = 0;
  for (std::size_t i = 0; i < x.size(); ++i) {
    xy += (x[i] - mean) * (y[i] - mean);
    xx += (x[i] - mean) * (x[i] - mean), yy += (y[i] - mean) * (y[i] - mean);
  }
  return xy / std::sqrt(xx * yy);
}

double median(std::vector<double> values) {
  std::ranges::sort(values);
  const std::size_t n = values.size();
  return 0.5 * (values[(n - 1) / 2] + values[n / 2]);
}

/// How well the network ranks what has depth. Depth along the optical axis, infinite in the sky.
double score(const DepthMap& depth, const std::vector<float>& depth_m) {
  std::vector<float> seen, truth;
  for (std::size_t i = 0; i < depth_m.size(); ++i)
    if (std::isfinite(depth_m[i])) seen.push_back(depth.inverse_depth[i]), truth.push_back(1 / depth_m[i]);
  return spearman(seen, truth);
}

}  // namespace

TEST_CASE("the street network passes its self-test and ranks depth on simulated pictures") {
  constexpr int width = 640, height = 192;
  const vehicle::NoiseTexture noise(2);
  std::vector<double> scores;
  double sky_seen_as_depth = 0, sky = 0;
  for (int i = 0; i < 12; ++i) {
    const vehicle::VariedView view = vehicle::varied_view(noise, 424242, i, width, height);
    const auto network = require_ok(make_onnx_depth(descriptor, view.camera, {}));
    if (i == 0) CHECK(require_ok(network->prepare()).empty());
    const DepthMap depth = require_ok(network->estimate({view.image, {}, {}}));
    REQUIRE(depth.width == width);
    REQUIRE(depth.height == height);
    for (std::size_t p = 0; p < depth.inverse_depth.size(); ++p)
      if (std::isinf(view.rendering.depth_m[p])) ++sky, sky_seen_as_depth += depth.inverse_depth[p] > 0;
    scores.push_back(score(depth, view.rendering.depth_m));
  }
  CAPTURE(scores);
  CHECK(median(scores) > 0.93);
  CHECK(sky_seen_as_depth < 0.1 * sky);
}

TEST_CASE("the street network ranks depth on the street that calib-sim drives through") {
  const vehicle::Rig rig = require_ok(vehicle::Rig::make(960, 288));
  const auto network = require_ok(make_onnx_depth(descriptor, rig.camera, {}));
  vehicle::Scene scene(1);
  std::vector<double> scores;
  for (int i = 0; i < 6; ++i) {
    const double t_s = 5 * i;
    const auto rendering =
        render(scene, scene.instances(t_s), rig.camera, scene.T_world_vehicle(t_s) * rig.T_vehicle_camera);
    const DepthMap depth = require_ok(network->estimate({expose(rendering, 0.9f, i), {}, {}}));
    scores.push_back(score(depth, rendering.depth_m));
  }
  CAPTURE(scores);
  CHECK(median(scores) > 0.9);
}

TEST_CASE("the street network ranks depth on real pictures") {
  const auto drive = test::kitti_drive();
  if (!drive) return test::skip("set CALIB_KITTI_DRIVE to a <date>/<drive> folder of KITTI raw");
  const auto recording = require_ok(open_kitti_raw(*drive));
  const auto network = require_ok(make_onnx_depth(descriptor, recording.camera(), {}));
  std::vector<double> scores, valid_shares;
  for (std::size_t i = 0; i < recording.size(); ++i) {
    const DepthMap depth = require_ok(network->estimate(require_ok(recording.frame(i))));
    const DepthMap stereo = require_ok(read_depth({*drive / "depth" / "stereo_net", DepthKind::disparity, {}},
                                                  recording.frame_name(i), recording.camera(), {}));
    // Where both have depth: of the sky the reference has the depth wrong, and the network none.
    std::vector<float> seen, truth;
    for (std::size_t p = 0; p < stereo.inverse_depth.size(); ++p)
      if (stereo.inverse_depth[p] > 0 && depth.inverse_depth[p] > 0)
        seen.push_back(depth.inverse_depth[p]), truth.push_back(stereo.inverse_depth[p]);
    scores.push_back(spearman(seen, truth));
    valid_shares.push_back(depth.valid_share());
  }
  CAPTURE(scores, valid_shares);
  CHECK(median(scores) > 0.8);
  CHECK(median(valid_shares) > 0.8);
}
