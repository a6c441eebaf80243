#include "config.hpp"

#include "fuzz/fuzz.hpp"

namespace calib::fuzz {

std::vector<Octets> seeds() {
  const std::string yaml = R"(vehicle: car
dds: {domain: 0, interface: lo}
sampling: {period: 10s, window: 2s, max_time_difference: 50ms}
pairs:
  - name: front
    camera: {image: /l, model: rectified, size: [640, 480], intrinsics: [500, 500, 320, 240]}
    lidar: &lidar {cloud: /p}
    T_camera_lidar: {translation_m: [0, 0, 0], quaternion_xyzw: [0, 0, 0, 1]}
    depth: {source: stereo, right_image: /r, baseline_m: 0.3}
    recalibration: {mode: apply, frames: 25, max_rotation_deg: 5, max_translation_cm: 50}
)";
  return {octets(yaml)};
}

}  // namespace calib::fuzz

int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t size) {
  calib::DefaultFolders defaults;
  defaults.state = "/state";
  defaults.runtime = "/runtime";
  defaults.credentials = "/credentials";
  const auto config = calib::parse_config(calib::fuzz::text(bytes, size), "c.yaml", defaults);
  if (config)
    calib::fuzz::require(!config->pairs.empty() && config->sampling.window <= config->sampling.period);
  else
    calib::fuzz::require(config.error().code == calib::ErrorCode::bad_config &&
                         config.error().context.starts_with("c.yaml:"));
  return 0;
}
