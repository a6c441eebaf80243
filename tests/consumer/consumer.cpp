// Scores a made-up frame at its extrinsic, and at its neighbours: what another project does with frames of its own.
#include <calib/drift.hpp>
#include <cmath>
#include <cstdint>
#include <cstdio>

int main() {
  const auto camera = calib::Camera::make(calib::CameraModel::rectified, 320, 120, {200, 200, 160, 60});
  if (!camera) return 1;
  calib::RigidTransform T_camera_lidar;  // LiDAR: x forward, y left, z up; camera: z forward, x right, y down
  T_camera_lidar.matrix() << 0, -1, 0, 0, 0, 0, -1, -0.1, 1, 0, 0, -0.2, 0, 0, 0, 1;

  // A wall with posts in front of it, as the camera's depth and as the LiDAR's points.
  calib::FramePair pair{{{}, 320, 120, {}}, {}, {}};
  calib::DepthMap depth{320, 120, {}};
  for (int v = 0; v < 120; ++v)
    for (int u = 0; u < 320; ++u) {
      const double z_m = u % 40 < 8 && v > 20 ? 6 + 0.02 * u : 15 + 0.03 * v;
      pair.image.pixels.push_back(static_cast<std::uint8_t>(u % 40 < 8 ? 200 : 90));
      depth.inverse_depth.push_back(static_cast<float>(1 / z_m));
      const Eigen::Vector3d p_camera = z_m * Eigen::Vector3d((u - 160) / 200.0, (v - 60) / 200.0, 1);
      const Eigen::Vector3f p = (T_camera_lidar.inverse() * p_camera).cast<float>();
      if (v % 2 == 0) pair.scan.points.push_back({p.x(), p.y(), p.z(), u % 40 < 8 ? 0.8F : 0.3F});
    }

  const auto features = calib::make_features(pair, depth, *camera, T_camera_lidar);
  if (!features) return std::fprintf(stderr, "%s\n", features.error().context.c_str()), 1;
  const calib::Stencil stencil = calib::evaluate_stencil(*features, T_camera_lidar);
  std::printf("points %zu\nscore %.6f\n", features->points(), calib::score(*features, T_camera_lidar).value);
  for (int axis = 0; axis < 6; ++axis)
    std::printf("%s %.6f %.6f\n", calib::axis_names[axis].data(), stencil.widths[0].minus[axis],
                stencil.widths[0].plus[axis]);
}
