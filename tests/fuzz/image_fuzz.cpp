#include "dds/decode.hpp"
#include "fuzz/fuzz.hpp"
#include "support/ros_messages.hpp"

namespace calib::fuzz {

Octets seed() {
  const test::ImageMessage good;
  Output out;
  out.put(good.sec).put(good.nanosec).put(good.width).put(good.height).put(good.step).put(good.is_bigendian);
  return out.put_text("mono16").with(Octets(200, 7));
}

}  // namespace calib::fuzz

int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t size) {
  calib::fuzz::Input input(bytes, size);
  calib::test::ImageMessage message;
  message.sec = input.take<std::int32_t>();
  message.nanosec = input.take<std::uint32_t>();
  message.width = input.take<std::uint32_t>();
  message.height = input.take<std::uint32_t>();
  message.step = input.take<std::uint32_t>();
  message.is_bigendian = input.take<std::uint8_t>();
  message.encoding = input.take_text();
  message.data = input.rest();
  // Mutation seldom makes a word; so every input is also read in every other encoding.
  for (const std::string& encoding :
       std::vector<std::string>{message.encoding, "mono8", "mono16", "rgb8", "bgra8", "bayer_rggb8",
                                "bayer_grbg8", "uyvy", "yuyv"}) {
    message.encoding = encoding;
    const auto image = calib::decode_image(message.raw());
    if (image)
      calib::fuzz::require(image->pixels.size() == std::size_t(image->width) * image->height);
    else
      calib::fuzz::require(image.error().code.starts_with("malformed:"));
  }
  return 0;
}
