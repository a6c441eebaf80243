#include "vehicle/lidar.hpp"

#include <algorithm>
#include <cmath>
#include <map>
#include <set>

#include "support/catch.hpp"
#include "support/support.hpp"
#include "vehicle/render.hpp"
#include "vehicle/rig.hpp"

using namespace calib;
using namespace calib::vehicle;

namespace {

Eigen::Vector3d position(const LidarPoint& point) { return {point.x_m, point.y_m, point.z_m}; }

/// The ray that a point was measured along: its column and its elevation, in thousandths of a degree.
std::pair<int, int> ray_of(const LidarPoint& point) {
  const double azimuth_deg = std::atan2(point.y_m, point.x_m) / radians_per_degree;
  const double elevation_deg = std::atan2(point.z_m, std::hypot(point.x_m, point.y_m)) / radians_per_degree;
  return {static_cast<int>(std::lround(azimuth_deg / 0.2 + 900)) % 1800,
          static_cast<int>(std::lround(1000 * elevation_deg))};
}

}  // namespace

TEST_CASE("the LiDAR sees the same world as the camera") {
  Scene scene(11);
  const Rig rig = test::require_ok(Rig::make(960, 288));
  for (const double t_s : {0.0, 8.5, 31.0, 60.0}) {
    const auto instances = scene.instances(t_s);
    const RigidTransform T_world_camera = scene.T_world_vehicle(t_s) * rig.T_vehicle_camera;
    const Rendering image = render(scene, instances, rig.camera, T_world_camera);
    const LidarScan ideal = scan(scene, instances, {.ideal = true}, T_world_camera * rig.T_camera_lidar, 0);
    int visible = 0, agree = 0, in_front = 0;
    for (const LidarPoint& point : ideal.points) {
      const Eigen::Vector3d p_camera = rig.T_camera_lidar * position(point);
      const auto uv = rig.camera.project(p_camera);
      if (!uv || uv->x() < 0 || uv->y() < 0 || uv->x() >= image.width - 1 || uv->y() >= image.height - 1) continue;
      ++visible;
      // On a surface 1/z is linear between pixels; at an edge the point lies on one of the two surfaces.
      const int x = static_cast<int>(uv->x()), y = static_cast<int>(uv->y());
      const double a = uv->x() - x, b = uv->y() - y;
      const auto inverse = [&](int dx, int dy) { return 1.0 / image.depth_m[(y + dy) * image.width + x + dx]; };
      const auto agrees = [&](double inverse_depth) { return std::abs(inverse_depth * p_camera.z() - 1) < 0.02; };
      const double between =
          (1 - b) * ((1 - a) * inverse(0, 0) + a * inverse(1, 0)) + b * ((1 - a) * inverse(0, 1) + a * inverse(1, 1));
      const double nearest = std::max({inverse(0, 0), inverse(1, 0), inverse(0, 1), inverse(1, 1)});
      in_front += nearest * p_camera.z() < 0.98;
      agree += agrees(between) || agrees(inverse(a > 0.5, b > 0.5));
    }
    REQUIRE(visible > 15'000);
    CHECK(agree >= 0.96 * visible);      // the rest is hidden from the camera by something nearer
    CHECK(in_front <= 0.001 * visible);  // the camera never sees past what the LiDAR hits
  }
}

TEST_CASE("rays leave at the model's elevations and azimuths and end within its range") {
  Scene scene(12);
  const LidarScan ideal =
      scan(scene, scene.instances(5), {.ideal = true}, scene.T_world_vehicle(5) * Eigen::Translation3d(0, 0, 1.7), 0);
  REQUIRE(ideal.points.size() > 60'000);
  std::set<int> elevations;
  std::set<std::pair<int, int>> rays;
  for (const LidarPoint& point : ideal.points) {
    const auto ray = ray_of(point);
    elevations.insert(ray.second);
    rays.insert(ray);
    REQUIRE(position(point).norm() < 80);
    REQUIRE(point.reflectance >= 0);
    REQUIRE(point.reflectance <= 1);
  }
  CHECK(*elevations.begin() == Approx(-24330).margin(2));
  CHECK(*elevations.rbegin() == Approx(2000).margin(2));
  CHECK(elevations.size() <= 3 * 64);  // each rounded up or down
  CHECK(rays.size() == ideal.points.size());
}

TEST_CASE("range noise is that of the model, and far, dark and slanting surfaces are lost first") {
  Scene scene(13);
  const auto instances = scene.instances(9);
  const RigidTransform T_world_lidar = scene.T_world_vehicle(9) * Eigen::Translation3d(0, 0, 1.7);
  const LidarScan ideal = scan(scene, instances, {.ideal = true}, T_world_lidar, 1);
  const LidarScan real = scan(scene, instances, {.dropout = 0.1f}, T_world_lidar, 1);
  std::map<std::pair<int, int>, double> ideal_range;
  for (const LidarPoint& point : ideal.points) ideal_range[ray_of(point)] = position(point).norm();
  const auto count = [](const LidarScan& points, double from_m, double to_m) {
    const auto found = std::ranges::count_if(points.points, [&](const LidarPoint& point) {
      return position(point).norm() >= from_m && position(point).norm() < to_m;
    });
    return static_cast<double>(found);
  };
  double square_sum = 0;
  int matched = 0;
  for (const LidarPoint& point : real.points) {
    const auto same_ray = ideal_range.find(ray_of(point));
    if (same_ray == ideal_range.end()) continue;  // rounded to the neighbouring thousandth of a degree
    square_sum += std::pow(position(point).norm() - same_ray->second, 2);
    ++matched;
  }
  REQUIRE(matched > 0.9 * static_cast<double>(real.points.size()));
  CHECK(std::sqrt(square_sum / matched) == Approx(0.02).epsilon(0.1));
  CHECK(count(real, 0, 15) == Approx(0.9 * count(ideal, 0, 15)).epsilon(0.03));
  CHECK(count(real, 50, 80) < 0.8 * count(ideal, 50, 80));
}

TEST_CASE("a narrower field of view is the part ahead of the whole turn") {
  Scene scene(14);
  const auto instances = scene.instances(2);
  const RigidTransform T_world_lidar = scene.T_world_vehicle(2) * Eigen::Translation3d(0, 0, 1.7);
  const LidarScan ahead =
      scan(scene, instances, {.azimuth_step_deg = 1, .field_of_view_deg = 90, .ideal = true}, T_world_lidar, 0);
  const LidarScan turn = scan(scene, instances, {.azimuth_step_deg = 1, .ideal = true}, T_world_lidar, 0);
  std::size_t within = 0;
  for (const LidarPoint& point : turn.points) {
    const double azimuth_deg = std::atan2(point.y_m, point.x_m) / radians_per_degree;
    within += azimuth_deg > -45.5 && azimuth_deg < 44.5;
  }
  CHECK(ahead.points.size() == within);
}

TEST_CASE("nothing around gives an empty scan") {
  const Scene scene(1);
  CHECK(scan(scene, {}, {}, RigidTransform::Identity(), 0).points.empty());
}
