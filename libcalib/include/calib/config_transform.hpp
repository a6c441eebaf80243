#pragma once

#include "calib/config_node.hpp"
#include "calib/geometry.hpp"

namespace calib {

/// A transform in one of the forms that a configuration may have:
/// - `translation_m` [x, y, z] and `quaternion_xyzw` [x, y, z, w];
/// - `translation_m` and `rpy_deg` [roll, pitch, yaw], degrees about the fixed axes x, y, z (`rotation_from_rpy`);
/// - `matrix`, 3x4 or 4x4: rows of four numbers, or all 12 or 16 numbers row by row.
/// Throws `BadConfig` for any other value, for two forms at once, and for a matrix or quaternion that is no rotation.
[[nodiscard]] RigidTransform read_transform(const ConfigNode& node);

/// The value of a key `matrix` as above.
[[nodiscard]] RigidTransform read_matrix(const ConfigNode& node);

/// Metres; a longer translation is refused.
inline constexpr double max_translation_m = 100;

}  // namespace calib
