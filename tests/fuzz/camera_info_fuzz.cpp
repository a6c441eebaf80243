#include <cmath>

#include "dds/decode.hpp"
#include "fuzz/fuzz.hpp"
#include "support/ros_messages.hpp"

namespace calib::fuzz {

std::vector<Octets> seeds() {
  const test::CameraInfoMessage good;
  Output out;
  out.put(good.sec).put(good.nanosec).put(good.width).put(good.height).put(good.k).put(good.p);
  out.put_text(good.distortion_model).put(static_cast<std::uint8_t>(good.d.size()));
  for (const double d : good.d) out.put(d);
  out.put(good.binning_x).put(good.binning_y).put(good.roi_x).put(good.roi_y).put(good.roi_width).put(good.roi_height);
  return {out.with({})};
}

}  // namespace calib::fuzz

int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t size) {
  calib::fuzz::Input input(bytes, size);
  calib::test::CameraInfoMessage message;
  message.sec = input.take<std::int32_t>();
  message.nanosec = input.take<std::uint32_t>();
  message.width = input.take<std::uint32_t>();
  message.height = input.take<std::uint32_t>();
  message.k = input.take<std::array<double, 9>>();
  message.p = input.take<std::array<double, 12>>();
  message.distortion_model = input.take_text();
  message.d.resize(input.take<std::uint8_t>());
  for (double& d : message.d) d = input.take<double>();
  for (auto* number : {&message.binning_x, &message.binning_y, &message.roi_x, &message.roi_y, &message.roi_width,
                       &message.roi_height})
    *number = input.take<std::uint32_t>();
  const auto info = calib::decode_camera_info(message.raw());
  if (!info) {
    calib::fuzz::require(is_malformed(info.error().code));
    return 0;
  }
  const bool has_k = info->K[0] != 0;
  calib::fuzz::require(info->width > 0 && info->height > 0 && (has_k ? info->K[0] : info->P[0]) > 1 &&
                       (has_k ? info->K[4] : info->P[5]) < 1e5);
  for (const double d : info->D) calib::fuzz::require(std::isfinite(d));
  if (!has_k) return 0;
  // The lens is a camera, or refused for its image's size; whatever it shows has its way back.
  const auto camera = calib::Camera::make(info->model, info->width, info->height,
                                          {info->K[0], info->K[4], info->K[2], info->K[5]}, info->D);
  calib::fuzz::require(camera.has_value() || info->width < 16 || info->height < 16);
  if (!camera) return 0;
  if (const auto uv = camera->project({0.1, -0.2, 1})) calib::fuzz::require(camera->unproject(*uv).has_value());
  return 0;
}
