#pragma once

#include <vector>

#include "calib/camera.hpp"
#include "calib/frame.hpp"
#include "vehicle/scene.hpp"

namespace calib::vehicle {

/// What a rectified camera sees before its sensor has its say. Row-major, one value per pixel.
struct Rendering {
  int width = 0, height = 0;
  std::vector<float> brightness;  // scene-referred, 1 = a white surface facing the sun
  std::vector<float> depth_m;     // along the optical axis; infinite where the sky is
};

/// Renders `instances` of `scene` from `T_world_camera` (optical frame: x right, y down, z forward).
[[nodiscard]] Rendering render(const Scene& scene, const std::vector<Instance>& instances,
                               const Camera& camera, const RigidTransform& T_world_camera);

/// The sensor: optics that blur a little, exposure, gamma, noise. `key` picks the noise; stamp left at 0.
[[nodiscard]] Image expose(const Rendering& rendering, float exposure, std::uint64_t key);

}  // namespace calib::vehicle
