#pragma once

#include <array>
#include <vector>

#include "calib/camera.hpp"
#include "calib/frame.hpp"
#include "vehicle/scene.hpp"

namespace calib::vehicle {

/// What a camera sees before its sensor has its say. Row-major, one value per pixel.
struct Rendering {
  int width = 0, height = 0;
  std::vector<float> brightness;  // scene-referred, 1 = a white surface facing the sun
  std::vector<float> depth_m;     // `render`: along the optical axis. `WideRenderer`: along the ray. Infinite: sky
};

/// For a rectified camera. Renders `instances` of `scene` from `T_world_camera` (optical frame: x right, y down, z
/// forward).
[[nodiscard]] Rendering render(const Scene& scene, const std::vector<Instance>& instances, const Camera& camera,
                               const RigidTransform& T_world_camera);

/// As above, of any instances, lit as one likes.
[[nodiscard]] Rendering render(const NoiseTexture& noise, const Light& light, const std::vector<Instance>& instances,
                               const Camera& camera, const RigidTransform& T_world_camera);

/// For cameras of any model, lenses of 180 degrees and more included: the scene is drawn on the faces of a cube and
/// looked up along each pixel's bearing. Brightness is the mean of four places within the pixel; depth is that of the
/// surface along the bearing of the pixel's centre. A pixel that the lens does not reach is black and at infinity.
class WideRenderer {
 public:
  explicit WideRenderer(const Camera& camera);

  [[nodiscard]] Rendering render(const Scene& scene, const std::vector<Instance>& instances,
                                 const RigidTransform& T_world_camera) const;

 private:
  int width_, height_;
  std::vector<Eigen::Vector3f> rays_;                         // bearing of every pixel, zero where it has none
  std::vector<std::array<Eigen::Vector3f, 2>> across_pixel_;  // change of the bearing to the next pixel: right, down
  int face_size_;                                             // pixels of the cube's edge
};

/// The sensor: optics that blur a little, exposure, gamma, noise. `key` picks the noise; stamp left at 0.
[[nodiscard]] Image expose(const Rendering& rendering, float exposure, std::uint64_t key);

}  // namespace calib::vehicle
