#include <cmath>

#include "dds/decode.hpp"
#include "fuzz/fuzz.hpp"
#include "support/ros_messages.hpp"

namespace calib::fuzz {

std::vector<Octets> seeds() {
  const test::DisparityMessage good;
  Output out;
  out.put(good.sec).put(good.image.nanosec).put(good.image.width).put(good.image.height).put(good.image.step);
  out.put(good.image.is_bigendian).put(good.f).put(good.t).put(good.min_disparity).put(good.max_disparity);
  out.put(good.window_x).put(good.window_y).put(good.window_width).put(good.window_height);
  return {out.put_text("32FC1").with(good.image.data)};
}

void check(const Result<DepthImage>& depth) {
  if (!depth) return require(is_malformed(depth.error().code));
  require(depth->inverse_depth.size() == std::size_t(depth->width) * depth->height);
  for (const float inverse : depth->inverse_depth) require(inverse >= 0 && std::isfinite(inverse));
}

}  // namespace calib::fuzz

int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t size) {
  calib::fuzz::Input input(bytes, size);
  calib::test::DisparityMessage message;
  calib::test::ImageMessage& image = message.image;
  message.sec = image.sec = input.take<std::int32_t>();
  image.nanosec = input.take<std::uint32_t>();
  image.width = input.take<std::uint32_t>();
  image.height = input.take<std::uint32_t>();
  image.step = input.take<std::uint32_t>();
  image.is_bigendian = input.take<std::uint8_t>();
  message.f = input.take<float>();
  message.t = input.take<float>();
  message.min_disparity = input.take<float>();
  message.max_disparity = input.take<float>();
  message.window_x = input.take<std::uint32_t>();
  message.window_y = input.take<std::uint32_t>();
  message.window_width = input.take<std::uint32_t>();
  message.window_height = input.take<std::uint32_t>();
  image.encoding = input.take_text();
  image.data = input.rest();
  for (const std::string& encoding : std::vector<std::string>{image.encoding, "16UC1", "32FC1"}) {
    image.encoding = encoding;
    calib::fuzz::check(calib::decode_depth(image.raw()));
    calib::fuzz::check(calib::decode_disparity(message.raw()));
  }
  return 0;
}
