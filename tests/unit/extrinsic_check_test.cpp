#include "dataset/extrinsic_check.hpp"

#include "support/catch.hpp"
#include "support/support.hpp"
#include "vehicle/camera_option.hpp"
#include "vehicle/rig.hpp"
#include "vehicle/vehicle.hpp"

using namespace calib;

namespace {

/// A whole revolution in a street, and the front half of it alone, as some recordings keep it.
struct Scans {
  Scans() {
    vehicle::Simulation simulation;
    simulation.width = 160, simulation.height = 64, simulation.lidar.azimuth_step_deg = 1;
    const auto drive = test::require_ok(vehicle::simulated_vehicle(simulation));
    whole = test::require_ok(drive.frame(0, 0, RigidTransform::Identity())).scan;
    for (const LidarPoint& point : whole.points)
      if (point.x_m > 0) front.points.push_back(point);
  }
  LidarScan whole, front;
};

RigidTransform T_optical_body() {
  RigidTransform T = RigidTransform::Identity();
  T.linear() << 0, -1, 0, 0, 0, -1, 1, 0, 0;
  return T;
}

/// A camera that looks `yaw_deg` to the left of the LiDAR's x axis, a little down, from beside it.
RigidTransform mounting(double yaw_deg) {
  Vector6 pose;
  pose << 0, 0.05, yaw_deg * radians_per_degree, 0.3, 0.2, -0.1;
  return T_optical_body() * perturbation(pose).inverse();
}

std::string complaint(const Camera& camera, const RigidTransform& T_camera_lidar, const LidarScan& scan) {
  const auto result = check_extrinsic(camera, T_camera_lidar, scan);
  if (result) return "";
  CHECK(result.error().code == "extrinsic_implausible");
  return result.error().context;
}

bool holds(const std::string& text, const char* part) { return text.find(part) != std::string::npos; }

}  // namespace

TEST_CASE("an extrinsic in the wrong direction or of the wrong frame is recognised") {
  const Scans scans;
  const auto rig = test::require_ok(vehicle::Rig::make(960, 288));
  const auto fisheye = test::require_ok(vehicle::parse_camera("fisheye-double-sphere", ""));
  for (const LidarScan* scan : {&scans.whole, &scans.front})
    for (const Camera* camera : {&rig.camera, &fisheye})
      for (const double yaw_deg : {0.0, 30.0, -30.0}) {
        const RigidTransform T = mounting(yaw_deg);
        INFO("yaw " << yaw_deg << ", " << camera->width() << " pixels, " << scan->points.size() << " points");
        CHECK(complaint(*camera, T, *scan).empty());
        CHECK(holds(complaint(*camera, T.inverse(), *scan), "looks like the inverse"));
        CHECK(holds(complaint(*camera, T_optical_body().inverse() * T, *scan), "body frame"));
        CHECK(holds(complaint(*camera, T.inverse() * T_optical_body(), *scan), "body frame"));
      }
}

TEST_CASE("a camera on its side or upside down is not mistaken for a wrong convention") {
  const Scans scans;
  const auto rig = test::require_ok(vehicle::Rig::make(960, 288));
  for (const double roll_deg : {90.0, -90.0, 180.0}) {
    INFO(roll_deg);
    const RigidTransform T =
        RigidTransform(Eigen::AngleAxisd(roll_deg * radians_per_degree, Eigen::Vector3d::UnitZ())) * mounting(0);
    CHECK(complaint(rig.camera, T, scans.whole).empty());
  }
}

TEST_CASE("a camera that looks away from all points is refused") {
  const Scans scans;
  const auto rig = test::require_ok(vehicle::Rig::make(960, 288));
  const auto text = complaint(rig.camera, mounting(180), scans.front);
  CHECK(holds(text, "puts 0 of "));
}
