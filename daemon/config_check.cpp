#include "config_check.hpp"

#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>

#include "signing_key.hpp"

namespace calib {

Result<void> check_files(const Config& config) {
  const bool readable = ::access(config.signing_key.c_str(), R_OK) == 0 || errno != EACCES;
  if (config.signing_key_is_given && readable)
    if (const auto key = load_signing_key(config); !key) return propagate(key);
  for (std::size_t i = 0; i < config.pairs.size(); ++i) {
    DepthConfig depth = config.pairs[i].depth;
    if (const auto pinned = pin_files(depth); !pinned)
      return fail(pinned.error().code, fmt::format("pairs[{}].depth: {}", i, pinned.error().context));
  }
  return {};
}

std::vector<std::string> probable_slips(const Config& config) {
  constexpr double largest_vehicle_m = 30, most_unequal = 1.5;
  std::vector<std::string> slips;
  for (std::size_t i = 0; i < config.pairs.size(); ++i) {
    const PairConfig& pair = config.pairs[i];
    const Camera& camera = pair.camera.camera;
    if (camera.cx() < 0 || camera.cx() > camera.width() || camera.cy() < 0 || camera.cy() > camera.height())
      slips.push_back(
          fmt::format("pairs[{}].camera.intrinsics: the principal point {:g}, {:g} is outside the image of {} x {} "
                      "pixels; are they "
                      "fx, fy, cx, cy, for images of that size?",
                      i, camera.cx(), camera.cy(), camera.width(), camera.height()));
    if (std::max(camera.fx(), camera.fy()) > most_unequal * std::min(camera.fx(), camera.fy()))
      slips.push_back(
          fmt::format("pairs[{}].camera.intrinsics: the focal lengths {:g} and {:g} differ by more than half; are they "
                      "fx, fy, cx, cy?",
                      i, camera.fx(), camera.fy()));
    const double distance_m = pair.T_camera_lidar.translation().norm();
    if (distance_m > largest_vehicle_m)
      slips.push_back(fmt::format(
          "pairs[{}].T_camera_lidar: camera and LiDAR are {:.3g} m apart; is it in millimetres?", i, distance_m));
  }
  return slips;
}

}  // namespace calib
