#include "camera_info_check.hpp"

#include <fmt/format.h>

#include <cmath>

namespace calib {

std::optional<StatedIntrinsics> stated_intrinsics(const CameraInfo& info, CameraModel model) {
  if (model == CameraModel::rectified && info.P[0] != 0)
    return StatedIntrinsics{"P", {info.P[0], info.P[5], info.P[2], info.P[6]}};
  if (info.K[0] == 0) return std::nullopt;
  return StatedIntrinsics{"K", {info.K[0], info.K[4], info.K[2], info.K[5]}};
}

std::optional<CameraInfoContradiction> contradiction(const CameraInfo& info, const Camera& camera) {
  using Of = CameraInfoContradiction::Of;
  if (info.width != camera.width() || info.height != camera.height())
    return CameraInfoContradiction{
        Of::size,
        fmt::format("CameraInfo is for {} x {} pixels{}, camera.size is {} x {}", info.width, info.height,
                    info.reduced_from.empty() ? "" : " (" + info.reduced_from + ")", camera.width(), camera.height())};
  const auto stated = stated_intrinsics(info, camera.model());
  if (!stated) return std::nullopt;
  const std::array<double, 4> ours{camera.fx(), camera.fy(), camera.cx(), camera.cy()};
  const auto list = [](const std::array<double, 4>& v) {
    return fmt::format("[{:.2f}, {:.2f}, {:.2f}, {:.2f}]", v[0], v[1], v[2], v[3]);
  };
  for (std::size_t i = 0; i < ours.size(); ++i)
    if (std::abs(stated->values[i] - ours[i]) > 0.5)
      return CameraInfoContradiction{
          Of::intrinsics,
          fmt::format("CameraInfo's {} has {}{}, camera.intrinsics are {}", stated->matrix, list(stated->values),
                      info.reduced_from.empty() ? "" : " (of " + info.reduced_from + ")", list(ours))};
  return std::nullopt;
}

Error error_of(const CameraInfoContradiction& contradiction) {
  const bool size = contradiction.of == CameraInfoContradiction::Of::size;
  return {ErrorCode::camera_info_mismatch,
          contradiction.seen + "; correct " + (size ? "camera.size and " : "") +
              "camera.intrinsics, or camera.info; without camera.info this is not checked"};
}

}  // namespace calib
