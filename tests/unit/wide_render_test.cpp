#include <algorithm>
#include <cmath>

#include "support/catch.hpp"
#include "support/support.hpp"
#include "vehicle/camera_option.hpp"
#include "vehicle/lidar.hpp"
#include "vehicle/render.hpp"
#include "vehicle/rig.hpp"

using namespace calib;
using namespace calib::vehicle;

namespace {

/// 1 / range at a place between pixels, as linear between them; nothing beside the sky.
std::optional<double> inverse_range_at(const Rendering& seen, const Eigen::Vector2d& uv) {
  const int x = static_cast<int>(std::floor(uv.x())), y = static_cast<int>(std::floor(uv.y()));
  if (x < 0 || y < 0 || x + 1 >= seen.width || y + 1 >= seen.height) return std::nullopt;
  const double right = uv.x() - x, down = uv.y() - y;
  double inverse = 0;
  for (const auto& [dx, dy] : {std::pair{0, 0}, {1, 0}, {0, 1}, {1, 1}}) {
    const float range = seen.depth_m[(y + dy) * seen.width + x + dx];
    if (std::isinf(range)) return std::nullopt;
    inverse += (dx == 1 ? right : 1 - right) * (dy == 1 ? down : 1 - down) / range;
  }
  return inverse;
}

struct Agreement {
  double share = 0;         // of the points, all over the image
  double share_behind = 0;  // of those behind the plane of the lens
  int behind = 0;
};

/// How many points of an ideal LiDAR lie where the rendered range says, within one per cent.
Agreement agreement(const Camera& camera, const Rendering& seen, const LidarScan& scan,
                    const RigidTransform& T_camera_lidar) {
  int compared = 0, same = 0, behind = 0, same_behind = 0;
  for (const LidarPoint& point : scan.points) {
    const Eigen::Vector3d p_camera = T_camera_lidar * Eigen::Vector3d(point.x_m, point.y_m, point.z_m);
    const auto uv = camera.project(p_camera);
    if (!uv) continue;
    const auto inverse = inverse_range_at(seen, *uv);
    if (!inverse) continue;
    const bool agrees = std::abs(*inverse * p_camera.norm() - 1) < 0.01;
    ++compared, same += agrees;
    if (p_camera.z() < 0) ++behind, same_behind += agrees;
  }
  REQUIRE(compared > 5000);
  return {static_cast<double>(same) / compared, behind == 0 ? 0 : static_cast<double>(same_behind) / behind, behind};
}

}  // namespace

// Physics: an ideal LiDAR 28 cm from the lens measures the same surfaces as the lens sees along its rays, but for what
// the one sees past an edge and the other does not, and for edges between the four pixels around a point.
// Bound: 93 % of the points agree to 1 %, those beside and behind the lens as well; turned by 2 degrees, fewer do.
TEST_CASE("a wide camera sees each LiDAR point at its range") {
  const auto rig = test::require_ok(Rig::make(960, 288));
  for (const char* lens : {"fisheye-double-sphere", "kitti-360-fisheye"}) {
    const Camera camera = test::require_ok(parse_camera(lens, ""));
    const WideRenderer renderer(camera);
    for (const double t_s : {0.0, 20.0}) {
      INFO(lens << " at " << t_s << " s");
      Scene scene(7);
      const auto instances = scene.instances(t_s);
      const RigidTransform T_world_camera = scene.T_world_vehicle(t_s) * rig.T_vehicle_camera;
      const Rendering seen = renderer.render(scene, instances, T_world_camera);
      const LidarScan scan = vehicle::scan(scene, instances, {.azimuth_step_deg = 0.5, .ideal = true},
                                           T_world_camera * rig.T_camera_lidar, 1);
      const Agreement right = agreement(camera, seen, scan, rig.T_camera_lidar);
      CHECK(right.share > 0.93);
      REQUIRE(right.behind > 50);
      CHECK(right.share_behind > 0.93);
      const RigidTransform turned(Eigen::AngleAxisd(2 * radians_per_degree, Eigen::Vector3d::UnitY()));
      CHECK(agreement(camera, seen, scan, turned * rig.T_camera_lidar).share < right.share - 0.1);
    }
  }
}

TEST_CASE("through a lens without distortion the cube shows what the rectified camera shows") {
  Scene scene(8);
  const auto rig = test::require_ok(Rig::make(480, 144));
  const auto instances = scene.instances(3);
  const RigidTransform T_world_camera = scene.T_world_vehicle(3) * rig.T_vehicle_camera;
  const Rendering flat = render(scene, instances, rig.camera, T_world_camera),
                  wide = WideRenderer(rig.camera).render(scene, instances, T_world_camera);
  int same_depth = 0, same_brightness = 0;
  for (int y = 0; y < flat.height; ++y)
    for (int x = 0; x < flat.width; ++x) {
      const int i = y * flat.width + x;
      const double along_axis = rig.camera.unproject(Eigen::Vector2d(x, y))->z();
      const bool both_sky = std::isinf(flat.depth_m[i]) && std::isinf(wide.depth_m[i]);
      same_depth += both_sky || std::abs(wide.depth_m[i] * along_axis / flat.depth_m[i] - 1) < 1e-3;
      same_brightness += std::abs(wide.brightness[i] - flat.brightness[i]) < 0.1f;
    }
  const int pixels = flat.width * flat.height;
  CHECK(same_depth > 0.98 * pixels);
  CHECK(same_brightness > 0.9 * pixels);
}

TEST_CASE("what the lens does not reach is black and at infinity") {
  Scene scene(9);
  const Camera camera = test::require_ok(parse_camera("kitti-360-fisheye", "175x175"));
  const Rendering seen =
      WideRenderer(camera).render(scene, scene.instances(0), scene.T_world_vehicle(0) * Eigen::Translation3d(0, 0, 2));
  REQUIRE_FALSE(camera.unproject(Eigen::Vector2d(0, 0)));
  CHECK(seen.brightness[0] == 0);
  CHECK(std::isinf(seen.depth_m[0]));
  CHECK(seen.brightness[87 * 175 + 87] > 0.02f);
}

TEST_CASE("a camera is asked for by name or by its numbers") {
  const auto half = test::require_ok(parse_camera("kitti-360-fisheye", ""));
  CHECK(half.width() == 700);
  const auto full = test::require_ok(parse_camera("kitti-360-fisheye", "1400x1400"));
  CHECK(full.fx() == Approx(1336.3220825849971));
  // The same ray, at the same place of the image.
  const Eigen::Vector3d p(3, 1, 2);
  const Eigen::Vector2d centre_offset(0.5, 0.5);
  CHECK((*full.project(p) + centre_offset).isApprox(2 * (*half.project(p) + centre_offset), 1e-9));

  const auto own = test::require_ok(parse_camera("eucm:200,201,320,240,0.6,1.1", "640x480"));
  CHECK(own.model() == CameraModel::eucm);
  CHECK(own.fy() == 201);
  CHECK(own.distortion() == std::vector<double>{0.6, 1.1});
  for (const auto& [text, size] : {std::pair{"eucm:200,201,320,240,0.6,1.1", ""},
                                   {"eucm:200,201,320", "640x480"},
                                   {"eucm:a,b,c,d", "640x480"},
                                   {"wide:1,2,3,4", "640x480"},
                                   {"some-lens", ""},
                                   {"kitti-360-fisheye", "700"},
                                   {"kitti-360-fisheye", "0x0"}}) {
    INFO(text << " " << size);
    CHECK(parse_camera(text, size).error().code == "bad_camera");
  }
}
