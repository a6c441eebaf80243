#include "vehicle/vehicle.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <numeric>

#include "support/catch.hpp"
#include "support/support.hpp"
#include "vehicle/knock.hpp"

using namespace calib;
using namespace calib::vehicle;

namespace {

Simulation small(std::uint64_t seed) {
  Simulation simulation;
  simulation.seed = seed;
  simulation.width = 320;
  simulation.height = 96;
  simulation.lidar.azimuth_step_deg = 1;
  return simulation;
}

const RigidTransform still = RigidTransform::Identity();

bool same(const LidarScan& a, const LidarScan& b) {
  return a.points.size() == b.points.size() &&
         std::memcmp(a.points.data(), b.points.data(), a.points.size() * sizeof(LidarPoint)) == 0;
}

double mean(const Image& image) {
  return std::accumulate(image.pixels.begin(), image.pixels.end(), 0.0) / static_cast<double>(image.pixels.size());
}

}  // namespace

TEST_CASE("a frame depends on the seed and its time, not on the frames before it") {
  const auto driven = test::require_ok(simulated_vehicle(small(21))),
             fresh = test::require_ok(simulated_vehicle(small(21)));
  FramePair last;
  for (std::size_t i = 0; i < 30; ++i) last = test::require_ok(driven.frame(i, 4.0 * static_cast<double>(i), still));
  const FramePair same_frame = test::require_ok(fresh.frame(29, 116, still));
  CHECK(last.image.pixels == same_frame.image.pixels);
  CHECK(last.right_image->pixels == same_frame.right_image->pixels);
  CHECK(same(last.scan, same_frame.scan));

  const FramePair back = test::require_ok(driven.frame(3, 12, still)),
                  first_time = test::require_ok(fresh.frame(3, 12, still));
  CHECK(back.image.pixels == first_time.image.pixels);
  CHECK(same(back.scan, first_time.scan));
  CHECK(back.image.pixels != last.image.pixels);
}

TEST_CASE("a LiDAR that measures late sees what one in time sees then, and the cameras see what they saw") {
  Simulation late = small(21), weaving = small(21);
  late.cloud_late_s = 0.25;
  weaving.weave_rad = late.weave_rad = 10 * radians_per_degree;
  const auto behind = test::require_ok(simulated_vehicle(late)), in_time = test::require_ok(simulated_vehicle(weaving));
  CHECK(behind.cloud_late_s == 0.25);
  const FramePair pair = test::require_ok(behind.frame(6, 1.5, still));
  CHECK(pair.image.pixels == test::require_ok(in_time.frame(6, 1.5, still)).image.pixels);
  CHECK(same(pair.scan, test::require_ok(in_time.frame(6, 1.75, still)).scan));
  CHECK_FALSE(same(pair.scan, test::require_ok(in_time.frame(6, 1.5, still)).scan));
}

TEST_CASE("a vehicle that weaves publishes its turn rate") {
  Simulation weaving = small(21);
  weaving.weave_rad = 10 * radians_per_degree;
  const auto straight = test::require_ok(simulated_vehicle(small(21))),
             swinging = test::require_ok(simulated_vehicle(weaving));
  constexpr double fastest = 10 * radians_per_degree * 2 * M_PI / weave_period_s;
  for (const double quarter : {0, 1, 2, 3}) {
    const double t_s = 12 * weave_period_s + quarter * weave_period_s / 4;
    const Eigen::Vector3d more = swinging.angular_velocity(t_s) - straight.angular_velocity(t_s);
    CHECK(more.z() == Approx(quarter == 0 ? fastest : quarter == 2 ? -fastest : 0).margin(0.02));
    CHECK(more.head<2>().norm() < 0.02);  // pitch and roll as the swung axes see them
    CHECK(straight.angular_velocity(t_s).norm() < 5 * radians_per_degree);
  }
}

TEST_CASE("another seed is another street") {
  const auto a = test::require_ok(simulated_vehicle(small(1))), b = test::require_ok(simulated_vehicle(small(2)));
  CHECK(test::require_ok(a.frame(0, 0, still)).image.pixels != test::require_ok(b.frame(0, 0, still)).image.pixels);
}

TEST_CASE("a knocked LiDAR leaves the images alone and measures the same world from where it is") {
  const auto vehicle = test::require_ok(simulated_vehicle(small(22)));
  const auto before = test::require_ok(vehicle.frame(4, 2, still));
  Vector6 delta;
  delta << 0.02, -0.03, 0.05, 0.1, -0.05, 0.08;
  const auto after = test::require_ok(vehicle.frame(4, 2, perturbation(delta)));
  CHECK(before.image.pixels == after.image.pixels);
  CHECK_FALSE(same(before.scan, after.scan));
  // The lowest beams see the road: put back where the LiDAR was, its points lie at the same height as before.
  const auto road_height = [](const LidarScan& scan, const RigidTransform& motion) {
    std::vector<double> heights;
    for (const LidarPoint& point : scan.points) {
      const Eigen::Vector3d p = motion * Eigen::Vector3d(point.x_m, point.y_m, point.z_m);
      if (p.x() > 3 && p.x() < 6 && std::abs(p.y()) < 1) heights.push_back(p.z());
    }
    std::nth_element(heights.begin(), heights.begin() + static_cast<std::ptrdiff_t>(heights.size() / 2), heights.end());
    return heights.at(heights.size() / 2);
  };
  CHECK(road_height(after.scan, perturbation(delta)) == Approx(road_height(before.scan, still)).margin(0.02));
  CHECK(std::abs(road_height(after.scan, still) - road_height(before.scan, still)) > 0.04);
}

TEST_CASE("in the dark the cameras see next to nothing and the LiDAR as much as ever") {
  Simulation simulation = small(23);
  const auto day = test::require_ok(test::require_ok(simulated_vehicle(simulation)).frame(0, 0, still));
  simulation.dark = true;
  const auto night = test::require_ok(test::require_ok(simulated_vehicle(simulation)).frame(0, 0, still));
  CHECK(mean(day.image) > 60);
  CHECK(mean(night.image) < 6);
  CHECK(same(day.scan, night.scan));
}

TEST_CASE("an image size that no camera has is refused") {
  Simulation simulation = small(1);
  simulation.width = 0;
  CHECK(simulated_vehicle(simulation).error().code == "bad_camera");
}

TEST_CASE("a knock comes at its time and stays") {
  const Knock knock{.rotation_deg = {0, -1, 0.5}, .translation_cm = {2, 0, -3}, .start_s = 4};
  CHECK(knock.at(3.99).isZero());
  Vector6 expected;
  expected << 0, -radians_per_degree, 0.5 * radians_per_degree, 0.02, 0, -0.03;
  CHECK(knock.at(4).isApprox(expected));
  CHECK(knock.at(400) == knock.at(4));
}

TEST_CASE("drift grows with the time since its start, on top of a knock") {
  const Knock knock{
      .rotation_deg = {1, 0, 0}, .drift_deg_per_minute = {0, 0, 6}, .drift_cm_per_minute = {0, 3, 0}, .start_s = 10};
  CHECK(knock.at(9).isZero());
  const Vector6 later = knock.at(10 + 30);
  CHECK(later[0] == Approx(radians_per_degree));
  CHECK(later[2] == Approx(3 * radians_per_degree));
  CHECK(later[4] == Approx(0.015));
}

TEST_CASE("moving the LiDAR moves its points by the inverse, and moving it back restores them") {
  Vector6 delta;
  delta << 0.1, -0.2, 0.3, 1, 2, -3;
  const RigidTransform motion = perturbation(delta);
  const LidarScan before{{}, {{10, -2, 1, 0.25f}, {0, 0, 0, 0}}};
  LidarScan moved = before;
  move_lidar(moved, motion);
  for (std::size_t i = 0; i < moved.points.size(); ++i) {
    const Eigen::Vector3d p_old(before.points[i].x_m, before.points[i].y_m, before.points[i].z_m);
    const Eigen::Vector3d p_new(moved.points[i].x_m, moved.points[i].y_m, moved.points[i].z_m);
    CHECK((motion * p_new - p_old).norm() < 1e-5);
    CHECK(moved.points[i].reflectance == before.points[i].reflectance);
  }
  move_lidar(moved, motion.inverse());
  CHECK(moved.points[0].x_m == Approx(10).margin(1e-5));
}
