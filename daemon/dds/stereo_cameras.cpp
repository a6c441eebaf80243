#include "dds/stereo_cameras.hpp"

#include <Eigen/Core>
#include <Eigen/LU>
#include <cmath>

namespace calib {
namespace {

Eigen::Matrix3d matrix(const std::array<double, 9>& row_major) {
  return Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(row_major.data());
}

bool is_rotation(const Eigen::Matrix3d& R) {
  return (R * R.transpose() - Eigen::Matrix3d::Identity()).norm() < 1e-3 && R.determinant() > 0;
}

/// Same size, and the same intrinsics to half a pixel.
bool are_alike(const Camera& a, const Camera& b) {
  const auto differ = [](double x, double y) { return std::abs(x - y) > 0.5; };
  return a.width() == b.width() && a.height() == b.height() && !differ(a.fx(), b.fx()) && !differ(a.fy(), b.fy()) &&
         !differ(a.cx(), b.cx()) && !differ(a.cy(), b.cy());
}

}  // namespace

Result<RightCamera> right_camera(const Camera& left, const StereoCameraInfo& infos) {
  const auto refuse = [](const std::string& what) {
    return fail(ErrorCode::bad_camera,
                "the right CameraInfo " + what + "; calibrate the stereo camera, or give right_camera");
  };
  const auto& P = infos.right->P;
  if (!(P[0] > 1 && P[5] > 1 && P[3] < 0)) return refuse("has no baseline in P (P[3] = -fx * baseline)");
  const RigidTransform baseline(Eigen::Translation3d(P[3] / P[0], P[7] / P[5], 0));
  if (left.model() == CameraModel::rectified) {
    auto camera =
        Camera::make(CameraModel::rectified, infos.right->width, infos.right->height, {P[0], P[5], P[2], P[6]});
    if (!camera) return refuse("is of no camera: " + camera.error().context);
    // Configurations have fewer digits than CameraInfo. Cameras that agree to those digits are the same.
    if (are_alike(left, *camera)) return rectified_right_camera(left, -baseline.translation().x());
    return RightCamera{std::move(*camera), baseline};
  }
  const auto& K = infos.right->K;
  auto camera = Camera::make(infos.right->model, infos.right->width, infos.right->height, {K[0], K[4], K[2], K[5]},
                             infos.right->D);
  if (!camera) return refuse("is of no camera: " + camera.error().context);
  const Eigen::Matrix3d R_rectified_right = matrix(infos.right->R),
                        R_rectified_left = infos.left ? matrix(infos.left->R) : Eigen::Matrix3d::Zero();
  if (!is_rotation(R_rectified_right) || !is_rotation(R_rectified_left))
    return refuse("or the left one has an R that is no rotation");
  return RightCamera{std::move(*camera),
                     RigidTransform(R_rectified_right.transpose()) * baseline * RigidTransform(R_rectified_left)};
}

}  // namespace calib
