#pragma once

#include <array>
#include <optional>
#include <string>
#include <string_view>

#include "dds/decode.hpp"

namespace calib {

// What CameraInfo says about a configured camera. Sampling and the doctor ask the same functions.

/// fx, fy, cx, cy of one of its matrices.
struct StatedIntrinsics {
  std::string_view matrix;
  std::array<double, 4> values;
};

/// Those that a camera of `model` must have: P's for rectified images, or K's where P is zero, as drivers leave it that
/// know of no rectification; K's for any other model, nothing where K is zero.
[[nodiscard]] std::optional<StatedIntrinsics> stated_intrinsics(const CameraInfo& info, CameraModel model);

/// How a CameraInfo contradicts the configuration: it is of another size, or its focal length or centre differ by more
/// than the last digits that people write down (half a pixel).
struct CameraInfoContradiction {
  enum class Of { size, intrinsics } of;
  std::string seen;  // both values, in one sentence without a remedy
};
[[nodiscard]] std::optional<CameraInfoContradiction> contradiction(const CameraInfo& info, const Camera& camera);

/// Its code and what to do about it: `camera_info_mismatch`.
[[nodiscard]] Error error_of(const CameraInfoContradiction& contradiction);

}  // namespace calib
