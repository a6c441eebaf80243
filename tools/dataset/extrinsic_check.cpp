#include "dataset/extrinsic_check.hpp"

#include <algorithm>
#include <array>

namespace calib {
namespace {

/// A way to read the numbers that were meant to be T_camera_lidar.
struct Reading {
  RigidTransform T_camera_lidar;
  const char* name;
};

struct View {
  std::size_t points;  // in view
  bool upright;        // the LiDAR's z axis points up in the image, within 45 degrees
};

View view_of(const Camera& camera, const RigidTransform& T_camera_lidar, const LidarScan& scan) {
  View view{0, -T_camera_lidar.linear()(1, 2) > 0.7};
  for (const LidarPoint& point : scan.points)
    view.points +=
        camera.project(T_camera_lidar * Eigen::Vector3d(point.x_m, point.y_m, point.z_m)).has_value() ? 1 : 0;
  return view;
}

}  // namespace

Result<void> check_extrinsic(const Camera& camera, const RigidTransform& T_camera_lidar, const LidarScan& scan) {
  RigidTransform T_optical_body = RigidTransform::Identity();
  T_optical_body.linear() << 0, -1, 0, 0, 0, -1, 1, 0, 0;
  const RigidTransform& T = T_camera_lidar;
  // In the order in which they are believed when they see about the same.
  const std::array readings{
      Reading{T.inverse(), "it looks like the inverse, T_lidar_camera"},
      Reading{T_optical_body * T,
              "its camera frame looks like the body frame (x forward, y left, z up) instead of the "
              "optical frame (x right, y down, z forward)"},
      Reading{T_optical_body * T.inverse(),
              "it looks like the inverse, T_lidar_camera, with the camera's body frame (x "
              "forward, y left, z up) instead of the optical frame"}};

  const View given = view_of(camera, T, scan);
  const bool sees_nothing = given.points * 200 < scan.points.size();
  if (given.upright && !sees_nothing) return {};
  const Reading* best = nullptr;
  std::size_t most = 0;
  for (const Reading& reading : readings) {
    const View view = view_of(camera, reading.T_camera_lidar, scan);
    if (!view.upright || view.points * 200 < scan.points.size() || 5 * view.points < 6 * most) continue;
    best = &reading, most = view.points;
  }
  // With a wide lens a wrong direction may see a few points more.
  const bool another_fits = best && 10 * most > 7 * given.points;
  if (!sees_nothing && !another_fits) return {};
  return fail("extrinsic_implausible", "T_camera_lidar puts " + std::to_string(given.points) + " of " +
                                           std::to_string(scan.points.size()) + " points into the image" +
                                           (given.upright ? "" : " and the camera on its side") +
                                           (another_fits ? ": " + std::string(best->name) : ""));
}

}  // namespace calib
