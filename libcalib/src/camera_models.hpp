#pragma once

#include <Eigen/Core>
#include <optional>
#include <vector>

#include "calib/camera.hpp"

/// The models of `CameraModel`'s table, between bearings and the normalised plane (the pixel is f m + c). `distortion`
/// is complete (five numbers for plumb_bob) and inside its ranges.
namespace calib::lens {

/// Half the angle of the cone about the optical axis inside which the model is one-to-one.
[[nodiscard]] double fold_angle_rad(CameraModel model, const std::vector<double>& distortion);

/// `p`, inside the cone and of norm `range`, on the normalised plane.
[[nodiscard]] Eigen::Vector2d to_plane(CameraModel model, const std::vector<double>& distortion,
                                       const Eigen::Vector3d& p, double range);

/// The unit bearing inside the cone, of half angle `fold_rad`, that `to_plane` maps to `m`; nothing when there is none.
[[nodiscard]] std::optional<Eigen::Vector3d> from_plane(CameraModel model, const std::vector<double>& distortion,
                                                        const Eigen::Vector2d& m, double fold_rad);

}  // namespace calib::lens
