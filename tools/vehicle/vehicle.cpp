#include "vehicle/vehicle.hpp"

#include <algorithm>
#include <cmath>
#include <memory>

#include "vehicle/knock.hpp"
#include "vehicle/render.hpp"
#include "vehicle/rig.hpp"

namespace calib::vehicle {
namespace {

/// From distances along the rays to those along the optical axis.
void turn_to_axis(const Camera& camera, std::vector<float>& depth_m) {
  std::size_t i = 0;
  for (int v = 0; v < camera.height(); ++v)
    for (int u = 0; u < camera.width(); ++u, ++i)
      if (const auto bearing = camera.unproject(Eigen::Vector2d(u, v)))
        depth_m[i] *= static_cast<float>(std::max(bearing->z(), 0.0));
}

RigidTransform T_world_vehicle(const Scene& scene, double weave_rad, double t_s) {
  RigidTransform pose = scene.T_world_vehicle(t_s);
  pose.rotate(Eigen::AngleAxisd(weave_rad * std::sin(2 * M_PI * t_s / weave_period_s), Eigen::Vector3d::UnitZ()));
  return pose;
}

}  // namespace

Result<Vehicle> simulated_vehicle(const Simulation& simulation) {
  auto rig = simulation.unrectified ? Rig::make_unrectified(simulation.width, simulation.height)
                                    : Rig::make(simulation.width, simulation.height);
  if (!rig) return propagate(rig);
  std::shared_ptr<const WideRenderer> wide;
  if (simulation.camera) {
    rig->camera = *simulation.camera;
    rig->baseline_m = 0;
  }
  if (simulation.camera || simulation.unrectified) wide = std::make_shared<WideRenderer>(rig->camera);
  const auto scene = std::make_shared<Scene>(simulation.seed);
  const auto frame = [simulation, rig = *rig, scene, wide](std::size_t index, double t_s,
                                                           const RigidTransform& motion) -> Result<SeenFrame> {
    const auto T_world_left_at = [&](double time_s) {
      return T_world_vehicle(*scene, simulation.weave_rad, time_s) * rig.T_vehicle_camera;
    };
    const double scan_s = t_s + simulation.cloud_late_s;
    const RigidTransform T_world_lidar = T_world_left_at(scan_s) * rig.T_camera_lidar * motion;
    const RigidTransform T_world_left = T_world_left_at(t_s);
    const float exposure = simulation.dark ? 4e-5f : 0.9f;
    const auto key = [&](std::uint64_t sensor) { return mix(simulation.seed, index, sensor); };
    SeenFrame seen;
    seen.scan = scan(*scene, scene->instances(scan_s), simulation.lidar, T_world_lidar, key(2));
    const auto instances = scene->instances(t_s);
    const auto look = [&](const RigidTransform& T_world_camera) {
      return wide ? wide->render(*scene, instances, T_world_camera)
                  : render(*scene, instances, rig.camera, T_world_camera);
    };
    Rendering left = look(T_world_left);
    seen.image = expose(left, exposure, key(0));
    if (rig.baseline_m > 0) seen.right_image = expose(look(T_world_left * rig.T_left_right()), exposure, key(1));
    if (wide) seen.range_m = left.depth_m;
    seen.depth_m = std::move(left.depth_m);
    if (wide) turn_to_axis(rig.camera, seen.depth_m);
    return seen;
  };
  const auto angular_velocity = [scene, weave_rad = simulation.weave_rad](double t_s) -> Eigen::Vector3d {
    constexpr double h = 1e-3;
    const Eigen::AngleAxisd turn((T_world_vehicle(*scene, weave_rad, t_s - h).linear().transpose() *
                                  T_world_vehicle(*scene, weave_rad, t_s + h).linear())
                                     .eval());
    return turn.axis() * turn.angle() / (2 * h);
  };
  return Vehicle{rig->camera,         rig->baseline_m, rig->R_rectified_left,   rig->R_rectified_right,
                 rig->T_camera_lidar, frame,           simulation.cloud_late_s, angular_velocity};
}

Result<Vehicle> recorded_vehicle(const Recording& recording, bool needs_stereo) {
  const bool has_stereo = recording.has_stereo() && recording.baseline_m();
  if (needs_stereo && !has_stereo)
    return fail(ErrorCode::no_right_images, "the recording has no right images, and a vehicle publishes both");
  const auto frame = [recording, has_stereo](std::size_t index, double,
                                             const RigidTransform& motion) -> Result<SeenFrame> {
    auto pair = recording.frame(index % recording.size());
    if (!pair) return propagate(pair);
    move_lidar(pair->scan, motion);
    if (!has_stereo) pair->right_image.reset();
    SeenFrame seen{*std::move(pair)};
    // What was measured, in the pixels of the image.
    if (seen.depth && !recording.depth_camera() && seen.depth->width == seen.image.width &&
        seen.depth->height == seen.image.height)
      for (const float inverse : seen.depth->inverse_depth) seen.depth_m.push_back(1 / inverse);
    return seen;
  };
  return Vehicle{.camera = recording.camera(),
                 .baseline_m = has_stereo ? *recording.baseline_m() : 0,
                 .T_camera_lidar = recording.T_camera_lidar(),
                 .frame = frame};
}

}  // namespace calib::vehicle
