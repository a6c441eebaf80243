#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "calib/depth_agreement.hpp"

namespace calib {

/// A way to read the numbers that were meant to be T_camera_lidar.
struct ExtrinsicReading {
  /// `inverse`, `body_frame`, `inverse_body_frame`, `radians_as_degrees` or `quaternion_wxyz`.
  std::string_view code;
  std::string_view words;  // "it looks like ..."
  RigidTransform T_camera_lidar;
};

/// What an extrinsic does to a scan, and what it was probably meant to be.
struct ExtrinsicOpinion {
  std::size_t points_in_view = 0;
  /// Hardly any point is in view: fewer than one in two hundred.
  bool sees_nothing = false;
  /// The LiDAR's z axis points up in the image, within 45 degrees.
  bool upright = false;
  /// How depth agrees with the scan as it is given; nothing without depth, or where too few points land on it.
  std::optional<DepthAgreement> agreement;
  /// Set when the extrinsic is implausible and another reading of its numbers fits; and how depth agrees then.
  std::optional<ExtrinsicReading> likely;
  std::optional<DepthAgreement> likely_agreement;

  [[nodiscard]] bool plausible() const { return !sees_nothing && !likely; }
};

/// Examines `T_camera_lidar`, which should map the LiDAR's frame (z up) to the camera's optical frame (x right, y down,
/// z forward). Other readings are: the inverse, a camera's body frame (x forward, y left, z up), both of these, angles
/// in radians that were taken for degrees, and a quaternion in the order w, x, y, z. (Degrees that were taken for
/// radians leave only the remainder of a turn: they could have been anything.) A camera that is mounted on its side or
/// upside down is plausible: no other reading sets it upright.
///
/// Without `depth` a reading fits when it has the points in view and sets the camera upright, and the given one does
/// not; the order of a quaternion cannot be judged so. With `depth` that, too, must agree with the scan, and better
/// than as given; then a wrong reading is found even where the given one has the points in view. `depth` is of the
/// camera's size.
[[nodiscard]] ExtrinsicOpinion examine_extrinsic(const Camera& camera, const RigidTransform& T_camera_lidar,
                                                 const LidarScan& scan, const DepthMap* depth = nullptr);

/// Fails with `extrinsic_implausible`, and what the extrinsic looks like, when it is not plausible.
[[nodiscard]] Result<void> check_extrinsic(const Camera& camera, const RigidTransform& T_camera_lidar,
                                           const LidarScan& scan);

}  // namespace calib
