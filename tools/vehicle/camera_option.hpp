#pragma once

#include <string>

#include "calib/camera.hpp"
#include "calib/result.hpp"

namespace calib::vehicle {

/// The camera that a person asks for: `MODEL:fx,fy,cx,cy[,distortion...]` with `size` as `WxH`, or the name of a lens,
/// which `size` scales when it is not empty:
/// - `fisheye-double-sphere`: 185 degrees across, 800 x 800;
/// - `kitti-360-fisheye`: Mei's model as of KITTI-360's image_02, at half its resolution, 700 x 700.
/// Fails with `bad_camera`.
[[nodiscard]] Result<Camera> parse_camera(const std::string& text, const std::string& size);

}  // namespace calib::vehicle
