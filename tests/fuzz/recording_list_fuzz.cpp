#include "dataset/recording.hpp"
#include "fuzz/fuzz.hpp"
#include "fuzz/scratch.hpp"

namespace calib::fuzz {

std::vector<Octets> seeds() {
  return {octets("camera: {model: double_sphere, size: [800, 800], intrinsics: [208, 208, 399.5, 399.5], "
                 "distortion: [-0.2, 0.6]}\n"
                 "T_camera_lidar: {translation_m: [-0.06, -0.08, -0.27], quaternion_xyzw: [0.5, -0.5, 0.5, 0.5]}\n"
                 "images: images\nclouds: clouds\n"),
          octets("camera: {model: rectified, size: [640, 480], intrinsics: [500, 500, 320, 240]}\n"
                 "T_camera_lidar:\n  matrix:\n  - [0, -1, 0, 0]\n  - [0, 0, -1, 0.1]\n  - [1, 0, 0, 0]\n"
                 "baseline_m: 0.5\nframes:\n- {image: a.png, right_image: r/a.png, cloud: a.bin}\n"
                 "- {image: b.png, right_image: r/b.png, cloud: b.bin}\n")};
}

}  // namespace calib::fuzz

int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t size) {
  const auto path = calib::fuzz::scratch().write("recording.yaml", calib::fuzz::text(bytes, size));
  const auto recording = calib::open_list(path);
  if (!recording) {
    calib::fuzz::require_code(recording.error(), {calib::ErrorCode::recording_not_found,
                                                  calib::ErrorCode::calibration_malformed, calib::ErrorCode::bad_camera,
                                                  calib::ErrorCode::bad_transform, calib::ErrorCode::frame_mismatch});
    return 0;
  }
  calib::fuzz::require(recording->size() > 0 && recording->camera().width() > 0 && recording->camera().height() > 0);
  calib::fuzz::require(recording->T_camera_lidar().matrix().allFinite());
  return 0;
}
