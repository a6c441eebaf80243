#pragma once

#include <filesystem>
#include <optional>

#include "calib/camera.hpp"
#include "calib/geometry.hpp"
#include "calib/result.hpp"

namespace calib {

/// The keys of a list (README.md beside this) that describe sensors: each may be missing, and others are not looked at.
struct CalibrationFile {
  std::optional<Camera> camera;
  int image_bits = 16;
  std::optional<RigidTransform> T_camera_lidar;
  std::optional<double> baseline_m;
};

/// Fails with `calibration_missing`, `calibration_malformed`, `bad_camera` or `bad_transform`.
[[nodiscard]] Result<CalibrationFile> read_calibration_file(const std::filesystem::path& yaml);

}  // namespace calib
