#include "vehicle/vehicle.hpp"

#include <memory>

#include "vehicle/knock.hpp"
#include "vehicle/render.hpp"
#include "vehicle/rig.hpp"

namespace calib::vehicle {

Result<Vehicle> simulated_vehicle(const Simulation& simulation) {
  auto rig = Rig::make(simulation.width, simulation.height);
  if (!rig) return tl::unexpected(rig.error());
  std::shared_ptr<const WideRenderer> wide;
  if (simulation.camera) {
    rig->camera = *simulation.camera;
    rig->baseline_m = 0;
    wide = std::make_shared<WideRenderer>(rig->camera);
  }
  const auto scene = std::make_shared<Scene>(simulation.seed);
  const auto frame = [simulation, rig = *rig, scene, wide](std::size_t index, double t_s,
                                                           const RigidTransform& motion) -> Result<SeenFrame> {
    const auto instances = scene->instances(t_s);
    const RigidTransform T_world_left = scene->T_world_vehicle(t_s) * rig.T_vehicle_camera;
    const RigidTransform T_world_lidar = T_world_left * rig.T_camera_lidar * motion;
    const float exposure = simulation.dark ? 4e-5f : 0.9f;
    const auto key = [&](std::uint64_t sensor) { return mix(simulation.seed, index, sensor); };
    SeenFrame seen;
    seen.scan = scan(*scene, instances, simulation.lidar, T_world_lidar, key(2));
    if (wide) {
      Rendering left = wide->render(*scene, instances, T_world_left);
      seen.image = expose(left, exposure, key(0));
      seen.range_m = std::move(left.depth_m);
    } else {
      const RigidTransform T_world_right = T_world_left * Eigen::Translation3d(rig.baseline_m, 0, 0);
      seen.image = expose(render(*scene, instances, rig.camera, T_world_left), exposure, key(0));
      seen.right_image = expose(render(*scene, instances, rig.camera, T_world_right), exposure, key(1));
    }
    return seen;
  };
  return Vehicle{rig->camera, rig->baseline_m, rig->T_camera_lidar, frame};
}

Result<Vehicle> recorded_vehicle(const Recording& recording) {
  if (!recording.has_stereo())
    return fail("no_right_images", "the recording has no right images, and a vehicle publishes both");
  const auto frame = [recording](std::size_t index, double, const RigidTransform& motion) -> Result<SeenFrame> {
    auto pair = recording.frame(index % recording.size());
    if (!pair) return tl::unexpected(pair.error());
    move_lidar(pair->scan, motion);
    return SeenFrame{*std::move(pair)};
  };
  return Vehicle{recording.camera(), *recording.baseline_m(), recording.T_camera_lidar(), frame};
}

}  // namespace calib::vehicle
