#include "calib/extrinsic_check.hpp"

#include "support/catch.hpp"
#include "support/simulated_drive.hpp"
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

namespace {

RigidTransform turned(RigidTransform T, const Eigen::Matrix3d& R) {
  T.linear() = R;
  return T;
}

/// R = Rz Ry Rx of the angles of `R`, each multiplied.
Eigen::Matrix3d scaled_angles(const Eigen::Matrix3d& R, double factor) {
  const Eigen::Vector3d zyx = R.eulerAngles(2, 1, 0) * factor;
  return (Eigen::AngleAxisd(zyx[0], Eigen::Vector3d::UnitZ()) * Eigen::AngleAxisd(zyx[1], Eigen::Vector3d::UnitY()) *
          Eigen::AngleAxisd(zyx[2], Eigen::Vector3d::UnitX()))
      .toRotationMatrix();
}

/// The ways in which the drive's extrinsic can be written wrongly, each with the code that it must be found by.
std::vector<std::pair<std::string, RigidTransform>> wrong_spellings(const RigidTransform& T) {
  const Eigen::AngleAxisd turn(T.linear());
  const Eigen::Quaterniond q(T.linear());
  const double degree = radians_per_degree;
  return {{"inverse", T.inverse()},
          {"body_frame", T_optical_body().inverse() * T},
          {"inverse_body_frame", T.inverse() * T_optical_body()},
          {"quaternion_wxyz", turned(T, Eigen::Quaterniond(q.z(), q.w(), q.x(), q.y()).toRotationMatrix())},
          {"radians_as_degrees", turned(T, scaled_angles(T.linear(), degree))},
          {"radians_as_degrees", turned(T.inverse(), scaled_angles(T.inverse().linear(), degree)).inverse()},
          {"radians_as_degrees", turned(T, Eigen::AngleAxisd(turn.angle() * degree, turn.axis()).toRotationMatrix())}};
}

}  // namespace

TEST_CASE("with depth, every wrong spelling of an extrinsic is recognised, and put right") {
  test::SimulatedDrive drive(5);
  const RigidTransform T = drive.T_camera_lidar();
  for (const int frame : {0, 3}) {
    const LidarScan scan = drive.scan(frame);
    const DepthMap depth = drive.depth(frame);
    for (const auto& [code, spelling] : wrong_spellings(T)) {
      INFO(code << " in frame " << frame);
      const ExtrinsicOpinion opinion = examine_extrinsic(drive.camera(), spelling, scan, &depth);
      REQUIRE(opinion.likely);
      CHECK(opinion.likely->code == code);
      CHECK(rotation_angle_rad(opinion.likely->T_camera_lidar.inverse() * T) < 1e-6);
      CHECK(opinion.likely_agreement->rank_correlation > 0.8);
      CHECK_FALSE(opinion.plausible());
    }
  }
}

TEST_CASE("with depth, an extrinsic that is right or has drifted by five degrees is plausible") {
  test::SimulatedDrive drive(5);
  for (const RigidTransform& motion :
       {RigidTransform::Identity(), test::knock(5, 0, 0), test::knock(0, 5, 0), test::knock(0, 0, 5, 0.5, 0.5, 0.5)}) {
    const DepthMap depth = drive.depth(1);
    const ExtrinsicOpinion opinion =
        examine_extrinsic(drive.camera(), drive.T_camera_lidar(), drive.scan(1, motion), &depth);
    CHECK(opinion.plausible());
    CHECK(opinion.agreement->rank_correlation > 0.5);
  }
}

TEST_CASE("depth without information does not contradict a correct extrinsic") {
  test::SimulatedDrive drive(5);
  DepthMap noise = drive.depth(1);
  vehicle::Random random(7);
  for (float& value : noise.inverse_depth) value = static_cast<float>(random.uniform(0.1, 1));
  const ExtrinsicOpinion opinion = examine_extrinsic(drive.camera(), drive.T_camera_lidar(), drive.scan(1), &noise);
  CHECK(opinion.plausible());
  CHECK(std::abs(opinion.agreement->rank_correlation) < 0.1);
}

TEST_CASE("a camera that looks away from all points is refused") {
  const Scans scans;
  const auto rig = test::require_ok(vehicle::Rig::make(960, 288));
  const auto text = complaint(rig.camera, mounting(180), scans.front);
  CHECK(holds(text, "brings 0 of "));
}
