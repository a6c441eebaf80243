#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>
#include <string_view>

#include "calib/result.hpp"

namespace calib {

using Vector6 = Eigen::Matrix<double, 6, 1>;
using Matrix6 = Eigen::Matrix<double, 6, 6>;

/// A rigid transform; a variable of this type is named `T_<to>_<from>`, so that
/// `p_camera = T_camera_lidar * p_lidar` (paper, Sec. "Mathematical Formulation"). Metres.
using RigidTransform = Eigen::Isometry3d;

/// Degrees appear only where people read.
inline constexpr double radians_per_degree = 0.017453292519943295;

/// Names of the six entries of a perturbation, in order.
inline constexpr std::array<std::string_view, 6> axis_names{"roll", "pitch", "yaw", "x", "y", "z"};

/// The rigid motion with parameters `delta` = (roll, pitch, yaw [rad], x, y, z [m]) about the axes of the frame it
/// acts in: rotation R = Rx(roll) Ry(pitch) Rz(yaw), then translation (the paper's Theta).
///
/// A LiDAR that has moved by `delta` in its own frame has `T_camera_lidar * perturbation(delta)` as its new
/// extrinsic. So a misalignment reads directly as the motion of the LiDAR.
[[nodiscard]] RigidTransform perturbation(const Vector6& delta);

/// `perturbation(delta)` whose rotation turns about `pivot` (metres, same frame) instead of the origin.
[[nodiscard]] RigidTransform perturbation_about(const Vector6& delta, const Eigen::Vector3d& pivot);

/// Inverse of `perturbation`: delta with |pitch| <= pi/2.
[[nodiscard]] Vector6 perturbation_parameters(const RigidTransform& motion);

/// Angle of the rotation part, in [0, pi] radians.
[[nodiscard]] double rotation_angle_rad(const RigidTransform& motion);

/// A transform from a translation (metres) and a quaternion (x, y, z, w).
/// Fails with `bad_transform` when a value is not finite or | |q| - 1 | > 1e-3; within that, q is normalised.
[[nodiscard]] Result<RigidTransform> make_transform(const std::array<double, 3>& translation_m,
                                                    const std::array<double, 4>& quaternion_xyzw);

/// A transform from a translation (metres) and a rotation matrix, of which the nearest rotation is taken.
/// Fails with `bad_transform` when a value is not finite, or when R is a reflection or an entry of R R^T is more than
/// `max_rotation_deviation` from the identity's.
[[nodiscard]] Result<RigidTransform> transform_from_matrix(const std::array<double, 3>& translation_m,
                                                           const Eigen::Matrix3d& R);
inline constexpr double max_rotation_deviation = 1e-3;

/// R = Rz(yaw) Ry(pitch) Rx(roll): turns about the fixed axes x, y, z in this order, as ROS (REP 103) and URDF have it.
/// Not the order of a perturbation.
[[nodiscard]] Eigen::Matrix3d rotation_from_rpy(const Eigen::Vector3d& roll_pitch_yaw_rad);
/// Inverse of `rotation_from_rpy`: |pitch| <= pi/2. Where the pitch is a right angle, the yaw is arbitrary and the roll
/// goes with it.
[[nodiscard]] Eigen::Vector3d roll_pitch_yaw_rad(const Eigen::Matrix3d& R);

/// The rotation as a unit quaternion (x, y, z, w) with w >= 0, the one form that is written anywhere.
[[nodiscard]] std::array<double, 4> quaternion_xyzw(const RigidTransform& transform);
[[nodiscard]] std::array<double, 3> translation_m(const RigidTransform& transform);

}  // namespace calib
