#pragma once

#include <optional>
#include <string>

namespace calib {

/// "0.62 degrees to the left, sigma 0.05", "3.1 cm forward", "0.00 degrees": how far a LiDAR has moved along one axis
/// of its own (0 .. 5: roll, pitch, yaw, x, y, z; rad or m). A LiDAR's axes are x forward, y left, z up, so by the
/// right hand a positive roll lowers the right side, a positive pitch the nose, and a positive yaw turns to the left.
[[nodiscard]] std::string motion_in_words(int axis, double amount, std::optional<double> sigma = {});

/// Its numbers alone, in degrees or cm.
[[nodiscard]] std::string amount_in_words(int axis, double amount);

}  // namespace calib
