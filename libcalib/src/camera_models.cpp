#include "calib/camera_models.hpp"

#include <cstdlib>
#include <numbers>

namespace calib {
namespace camera_models {

Rectified::Rectified(std::span<const double>) {}
double Rectified::cone_rad() const { return std::numbers::pi / 2; }
Eigen::Vector2d Rectified::to_plane(const Eigen::Vector3d& p, double) const { return p.head<2>() / p.z(); }
Bearing Rectified::from_plane(const Eigen::Vector2d& m, double) const {
  return Eigen::Vector3d(m.x(), m.y(), 1).normalized();
}

}  // namespace camera_models

CameraLens make_lens(CameraModel model, std::span<const double> distortion) {
  switch (model) {
#define CALIB_MODEL(name, Struct) \
  case CameraModel::name:         \
    return camera_models::Struct(distortion);
    CALIB_CAMERA_MODELS(CALIB_MODEL)
#undef CALIB_MODEL
  }
  std::abort();  // no other value can be made
}

}  // namespace calib
