#include "dataset/kitti_calibration.hpp"

#include "fuzz/fuzz.hpp"
#include "fuzz/scratch.hpp"

namespace calib::fuzz {

std::vector<Octets> seeds() {
  return {octets("calib_time: 01-Jan-2026 12:00:00\ncorner_dist: 9.950000e-02\nS_rect_00: 1.242000e+03 3.750000e+02\n"
                 "R: 0.0 -1.0 0.0 0.0 0.0 -1.0 1.0 0.0 0.0\nT: -0.06 -0.08 -0.27\n"
                 "P_rect_00: 720 0 610 0 0 720 170 0 0 0 1 0\nP_rect_01: 720 0 610 -387 0 720 170 0 0 0 1 0\n"),
          octets("0 -1 0 0.1 0 0 -1 0.2 1 0 0 0.3\n")};
}

}  // namespace calib::fuzz

int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t size) {
  using calib::fuzz::require, calib::fuzz::require_code;
  const auto file =
      calib::KittiCalibration::read(calib::fuzz::scratch().write("calib.txt", calib::fuzz::text(bytes, size)));
  if (!file) {
    require_code(file.error(), {calib::ErrorCode::calibration_missing, calib::ErrorCode::calibration_malformed});
    return 0;
  }
  if (const auto camera = calib::KittiRectifiedCamera::read(*file, "00"))
    require(camera->camera.width() > 0 && camera->camera.height() > 0);
  else
    require_code(camera.error(), {calib::ErrorCode::calibration_malformed, calib::ErrorCode::bad_camera});
  if (const auto rotation = file->rotation("R"))
    require((*rotation * rotation->transpose()).isIdentity(1e-6));
  else
    require_code(rotation.error(), {calib::ErrorCode::calibration_malformed});
  if (const auto transform = file->transform(""); transform) require(transform->matrix().allFinite());
  if (const auto baseline_m = calib::kitti_baseline_m(*file, "00", "01"); baseline_m && *baseline_m)
    require(**baseline_m > 0);
  return 0;
}
