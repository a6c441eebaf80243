#include "calib/depth_agreement.hpp"

#include <cmath>

#include "support/catch.hpp"
#include "support/simulated_drive.hpp"

using namespace calib;
using test::require_ok;

namespace {

/// The same depth, each value changed.
template <typename Change>
DepthMap changed(DepthMap depth, const Change& change) {
  for (float& value : depth.inverse_depth)
    if (value > 0) value = static_cast<float>(change(value));
  return depth;
}

}  // namespace

TEST_CASE("true depth agrees with the scan, in order and in scale") {
  test::SimulatedDrive drive(4);
  const auto agreement = depth_agreement(drive.depth(0), drive.camera(), drive.T_camera_lidar(), drive.scan(0));
  REQUIRE(agreement);
  CHECK(agreement->rank_correlation > 0.95);
  CHECK(agreement->scale == Approx(1).epsilon(0.02));
  CHECK(agreement->points > 3000);
}

TEST_CASE("a monotone distortion changes the scale, not the rank correlation") {
  test::SimulatedDrive drive(4);
  const DepthMap depth = drive.depth(0);
  const LidarScan scan = drive.scan(0);
  const auto of = [&](const DepthMap& map) {
    return *depth_agreement(map, drive.camera(), drive.T_camera_lidar(), scan);
  };
  const double exact = of(depth).rank_correlation;
  CHECK(of(changed(depth, [](float d) { return 5 * std::sqrt(d); })).rank_correlation == Approx(exact).epsilon(1e-4));
  CHECK(of(changed(depth, [](float d) { return 3.2808F * d; })).scale ==
        Approx(3.2808 * of(depth).scale).epsilon(1e-4));
  // Far taken for near.
  CHECK(of(changed(depth, [](float d) { return 1 / d; })).rank_correlation == Approx(-exact).epsilon(1e-4));
}

TEST_CASE("depth along the ray is compared with the distance along the ray") {
  test::SimulatedDrive drive(4);
  DepthMap depth = drive.depth(0);
  for (int v = 0; v < depth.height; ++v)
    for (int u = 0; u < depth.width; ++u) {
      const auto bearing = drive.camera().unproject({u, v});
      depth.inverse_depth[static_cast<std::size_t>(v) * depth.width + u] *= static_cast<float>(bearing->z());
    }
  depth.along_ray = true;
  const auto agreement = depth_agreement(depth, drive.camera(), drive.T_camera_lidar(), drive.scan(0));
  CHECK(agreement->scale == Approx(1).epsilon(0.02));
}

TEST_CASE("constant depth carries no information") {
  test::SimulatedDrive drive(4);
  const DepthMap flat = changed(drive.depth(0), [](float) { return 0.1F; });
  CHECK(depth_agreement(flat, drive.camera(), drive.T_camera_lidar(), drive.scan(0))->rank_correlation == 0);
}

TEST_CASE("where hardly a point lands on depth there is no agreement") {
  test::SimulatedDrive drive(4);
  const DepthMap depth = drive.depth(0);
  const RigidTransform T = drive.T_camera_lidar();
  CHECK_FALSE(depth_agreement(depth, drive.camera(), T, {}));
  CHECK_FALSE(depth_agreement(changed(depth, [](float) { return 0; }), drive.camera(), T, drive.scan(0)));
  const DepthMap small{8, 8, std::vector<float>(64, 1)};
  CHECK_FALSE(depth_agreement(small, drive.camera(), T, drive.scan(0)));
  LidarScan broken = drive.scan(0);
  for (LidarPoint& point : broken.points) point.x_m = std::nanf("");
  CHECK_FALSE(depth_agreement(depth, drive.camera(), T, broken));
}
