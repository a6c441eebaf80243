#include <opencv2/imgcodecs.hpp>

#include "dds/decode.hpp"
#include "fuzz/fuzz.hpp"
#include "support/ros_messages.hpp"

namespace calib::fuzz {

Octets seed() {
  Octets jpeg, png;
  cv::Mat scene(16, 24, CV_8UC3);
  cv::randu(scene, 0, 255);
  require(cv::imencode(".jpg", scene, jpeg) && cv::imencode(".png", scene, png));
  return Output().put(static_cast<std::uint32_t>(jpeg.size())).with([&] {
    jpeg.insert(jpeg.end(), png.begin(), png.end());
    return jpeg;
  }());
}

void decode(const Octets& data) {
  test::CompressedImageMessage message;
  message.data = data;
  const auto image = decode_compressed_image(message.raw());
  if (image)
    require(image->pixels.size() == std::size_t(image->width) * image->height);
  else
    require(image.error().code.starts_with("malformed:"));
}

}  // namespace calib::fuzz

/// A length, then a JPEG of that length, then a PNG: both in one input, so that one seed serves both
/// decoders.
int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t size) {
  calib::fuzz::Input input(bytes, size);
  const std::size_t length = input.take<std::uint32_t>();
  const calib::fuzz::Octets both = input.rest();
  const auto middle = both.begin() + static_cast<std::ptrdiff_t>(std::min(length, both.size()));
  calib::fuzz::decode({both.begin(), middle});
  calib::fuzz::decode({middle, both.end()});
  return 0;
}
