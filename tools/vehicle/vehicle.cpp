#include "vehicle/vehicle.hpp"

#include <memory>

#include "vehicle/knock.hpp"
#include "vehicle/render.hpp"
#include "vehicle/rig.hpp"

namespace calib::vehicle {

Result<Vehicle> simulated_vehicle(const Simulation& simulation) {
  const auto rig = Rig::make(simulation.width, simulation.height);
  if (!rig) return tl::unexpected(rig.error());
  const auto scene = std::make_shared<Scene>(simulation.seed);
  const auto frame = [simulation, rig = *rig, scene](std::size_t index, double t_s,
                                                     const RigidTransform& motion) -> Result<FramePair> {
    const auto instances = scene->instances(t_s);
    const RigidTransform T_world_left = scene->T_world_vehicle(t_s) * rig.T_vehicle_camera;
    const RigidTransform T_world_right = T_world_left * Eigen::Translation3d(rig.baseline_m, 0, 0);
    const RigidTransform T_world_lidar = T_world_left * rig.T_camera_lidar * motion;
    const float exposure = simulation.dark ? 4e-5f : 0.9f;
    const auto key = [&](std::uint64_t sensor) { return mix(simulation.seed, index, sensor); };
    return FramePair{expose(render(*scene, instances, rig.camera, T_world_left), exposure, key(0)),
                     expose(render(*scene, instances, rig.camera, T_world_right), exposure, key(1)),
                     scan(*scene, instances, simulation.lidar, T_world_lidar, key(2))};
  };
  return Vehicle{rig->camera, rig->baseline_m, rig->T_camera_lidar, frame};
}

Result<Vehicle> recorded_vehicle(const Recording& recording) {
  if (!recording.has_stereo())
    return fail("no_right_images", "the recording has no right images, and a vehicle publishes both");
  const auto frame = [recording](std::size_t index, double, const RigidTransform& motion) {
    auto pair = recording.frame(index % recording.size());
    if (pair) move_lidar(pair->scan, motion);
    return pair;
  };
  return Vehicle{recording.camera(), *recording.baseline_m(), recording.T_camera_lidar(), frame};
}

}  // namespace calib::vehicle
