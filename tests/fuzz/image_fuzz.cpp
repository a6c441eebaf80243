#include <array>

#include "dds/decode.hpp"
#include "fuzz/fuzz.hpp"
#include "support/ros_messages.hpp"

namespace calib::fuzz {

/// Mutation seldom makes a word; so a number picks the encoding, and any other number the text of the input.
constexpr std::array encodings{"mono8",  "8UC1",  "mono16",      "rgb8",        "bgr8",        "8UC3",
                               "rgba8",  "bgra8", "bayer_rggb8", "bayer_bggr8", "bayer_gbrg8", "bayer_grbg8",
                               "yuv422", "uyvy",  "yuv422_yuy2", "yuyv"};

std::vector<Octets> seeds() {
  std::vector<Octets> all;
  for (std::uint8_t encoding = 0; encoding <= encodings.size(); ++encoding) {
    test::ImageMessage good;
    good.step = 24;
    Output out;
    out.put(encoding).put(good.sec).put(good.nanosec).put(good.width).put(good.height).put(good.step);
    all.push_back(out.put(good.is_bigendian).put_text("mono16").with(Octets(96, 7)));
  }
  return all;
}

void check(const Result<Image>& grey, const Result<Image>& colour) {
  if (!grey) {
    require(is_malformed(grey.error().code));
    return require(!colour && colour.error().code == grey.error().code);
  }
  require(grey->pixels.size() == std::size_t(grey->width) * grey->height && grey->rgb.empty());
  require(colour.has_value() && colour->pixels == grey->pixels);
  require(colour->rgb.empty() || colour->rgb.size() == 3 * grey->pixels.size());
}

}  // namespace calib::fuzz

int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t size) {
  calib::fuzz::Input input(bytes, size);
  calib::test::ImageMessage message;
  const std::size_t encoding = input.take<std::uint8_t>();
  message.sec = input.take<std::int32_t>();
  message.nanosec = input.take<std::uint32_t>();
  message.width = input.take<std::uint32_t>();
  message.height = input.take<std::uint32_t>();
  message.step = input.take<std::uint32_t>();
  message.is_bigendian = input.take<std::uint8_t>();
  message.encoding = input.take_text();
  if (encoding < calib::fuzz::encodings.size()) message.encoding = calib::fuzz::encodings[encoding];
  message.data = input.rest();
  calib::fuzz::check(calib::decode_image(message.raw(), calib::Colour::none),
                     calib::decode_image(message.raw(), calib::Colour::rgb));
  return 0;
}
