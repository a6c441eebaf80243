#include <opencv2/imgcodecs.hpp>

#include "dds/decode.hpp"
#include "fuzz/fuzz.hpp"
#include "support/ros_messages.hpp"

namespace calib::fuzz {

/// JPEG and PNG, each grey and in colour, and a progressive JPEG.
std::vector<Octets> seeds() {
  std::vector<Octets> all;
  for (const int type : {CV_8UC1, CV_8UC3}) {
    cv::Mat scene(16, 24, type);
    cv::RNG(7).fill(scene, cv::RNG::UNIFORM, 0, 255);
    for (const char* extension : {".jpg", ".png"})
      require(cv::imencode(extension, scene, all.emplace_back(), {cv::IMWRITE_JPEG_QUALITY, 50}));
    require(cv::imencode(".jpg", scene, all.emplace_back(),
                         {cv::IMWRITE_JPEG_PROGRESSIVE, 1, cv::IMWRITE_JPEG_QUALITY, 50}));
  }
  return all;
}

void check(const Result<Image>& image) {
  if (!image) return require(is_malformed(image.error().code));
  const std::size_t pixels = std::size_t(image->width) * image->height;
  require(image->pixels.size() == pixels && (image->rgb.empty() || image->rgb.size() == 3 * pixels));
}

}  // namespace calib::fuzz

int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t size) {
  calib::test::CompressedImageMessage message;
  message.data.assign(bytes, bytes + size);
  for (const auto colour : {calib::Colour::none, calib::Colour::rgb})
    calib::fuzz::check(calib::decode_compressed_image(message.raw(), colour));
  return 0;
}
