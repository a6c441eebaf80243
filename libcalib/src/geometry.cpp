#include "calib/geometry.hpp"

#include <Eigen/SVD>
#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <string>

namespace calib {
namespace {

std::string four_digits(double value) {
  std::array<char, 32> text;
  return {text.data(), std::to_chars(text.begin(), text.end(), value, std::chars_format::general, 4).ptr};
}

}  // namespace

RigidTransform perturbation(const Vector6& delta) {
  RigidTransform motion = RigidTransform::Identity();
  motion.linear() =
      (Eigen::AngleAxisd(delta[0], Eigen::Vector3d::UnitX()) * Eigen::AngleAxisd(delta[1], Eigen::Vector3d::UnitY()) *
       Eigen::AngleAxisd(delta[2], Eigen::Vector3d::UnitZ()))
          .toRotationMatrix();
  motion.translation() = delta.tail<3>();
  return motion;
}

RigidTransform perturbation_about(const Vector6& delta, const Eigen::Vector3d& pivot) {
  RigidTransform motion = perturbation(delta);
  motion.translation() += pivot - motion.linear() * pivot;
  return motion;
}

Vector6 perturbation_parameters(const RigidTransform& motion) {
  // R = Rx Ry Rz: R(0,2) = sin(pitch). Yaw is taken from Rx^-1 R, whose middle row is (sin(yaw), cos(yaw), 0): so roll
  // and yaw stay consistent with each other where the pitch is a right angle and only their sum or difference is
  // defined.
  const Eigen::Matrix3d R = motion.linear();
  Vector6 delta;
  delta[0] = std::atan2(-R(1, 2), R(2, 2));
  delta[1] = std::asin(std::clamp(R(0, 2), -1.0, 1.0));
  const double c = std::cos(delta[0]), s = std::sin(delta[0]);
  delta[2] = std::atan2(c * R(1, 0) + s * R(2, 0), c * R(1, 1) + s * R(2, 1));
  delta.tail<3>() = motion.translation();
  return delta;
}

double rotation_angle_rad(const RigidTransform& motion) {
  const Eigen::Quaterniond q(motion.linear());
  return 2 * std::atan2(q.vec().norm(), std::abs(q.w()));
}

Result<RigidTransform> make_transform(const std::array<double, 3>& translation,
                                      const std::array<double, 4>& quaternion) {
  const auto finite = [](double value) { return std::isfinite(value); };
  if (!std::ranges::all_of(translation, finite) || !std::ranges::all_of(quaternion, finite))
    return fail(ErrorCode::bad_transform, "a transform holds a number that is not finite");
  const Eigen::Quaterniond q(quaternion[3], quaternion[0], quaternion[1], quaternion[2]);
  if (std::abs(q.norm() - 1) > 1e-3)
    return fail(ErrorCode::bad_transform,
                "quaternion_xyzw has norm " + std::to_string(q.norm()) + " where 1 is needed (order is x, y, z, w)");
  RigidTransform transform = RigidTransform::Identity();
  transform.linear() = q.normalized().toRotationMatrix();
  transform.translation() = Eigen::Vector3d(translation[0], translation[1], translation[2]);
  return transform;
}

Result<RigidTransform> transform_from_matrix(const std::array<double, 3>& translation, const Eigen::Matrix3d& R) {
  if (!std::ranges::all_of(translation, [](double value) { return std::isfinite(value); }) || !R.allFinite())
    return fail(ErrorCode::bad_transform, "a transform holds a number that is not finite");
  const double deviation = (R * R.transpose() - Eigen::Matrix3d::Identity()).cwiseAbs().maxCoeff();
  if (!(deviation <= max_rotation_deviation))
    return fail(ErrorCode::bad_transform, "is not a rotation: an entry of R R^T differs from the identity by " +
                                              four_digits(deviation) + ", and at most " +
                                              four_digits(max_rotation_deviation) + " is allowed");
  if (R.determinant() < 0)
    return fail(ErrorCode::bad_transform, "is a reflection instead of a rotation: its determinant is -1");
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(R, Eigen::ComputeFullU | Eigen::ComputeFullV);
  RigidTransform transform = RigidTransform::Identity();
  transform.linear() = svd.matrixU() * svd.matrixV().transpose();
  transform.translation() = Eigen::Vector3d(translation[0], translation[1], translation[2]);
  return transform;
}

Eigen::Matrix3d rotation_from_rpy(const Eigen::Vector3d& angles) {
  return (Eigen::AngleAxisd(angles.z(), Eigen::Vector3d::UnitZ()) *
          Eigen::AngleAxisd(angles.y(), Eigen::Vector3d::UnitY()) *
          Eigen::AngleAxisd(angles.x(), Eigen::Vector3d::UnitX()))
      .toRotationMatrix();
}

Eigen::Vector3d roll_pitch_yaw_rad(const Eigen::Matrix3d& R) {
  // Roll is taken from Rz(yaw)^-1 R, so that it goes with the yaw where only their sum or difference is defined.
  const double yaw = std::atan2(R(1, 0), R(0, 0)), c = std::cos(yaw), s = std::sin(yaw);
  const double pitch = std::atan2(-R(2, 0), std::hypot(R(0, 0), R(1, 0)));  // asin loses half the digits at pi/2
  return {std::atan2(s * R(0, 2) - c * R(1, 2), c * R(1, 1) - s * R(0, 1)), pitch, yaw};
}

std::array<double, 4> quaternion_xyzw(const RigidTransform& transform) {
  Eigen::Quaterniond q(transform.linear());
  q.normalize();
  const double sign = q.w() < 0 ? -1 : 1;
  return {sign * q.x(), sign * q.y(), sign * q.z(), sign * q.w()};
}

std::array<double, 3> translation_m(const RigidTransform& transform) {
  const auto& t = transform.translation();
  return {t.x(), t.y(), t.z()};
}

}  // namespace calib
