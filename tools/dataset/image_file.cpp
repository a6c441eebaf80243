#include "dataset/image_file.hpp"

#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "dataset/encoded_image.hpp"

namespace calib {

Result<Image> read_image(const std::filesystem::path& path, Colours colours, std::optional<std::pair<int, int>> size) {
  const auto encoded = EncodedImage::read(path, ErrorCode::image_unreadable);
  if (!encoded) return propagate(encoded);
  const ImageHeader& header = encoded->header();
  if (size && (header.width != size->first || header.height != size->second))
    return fail(ErrorCode::image_unreadable, path.string() + " is " + std::to_string(header.width) + " x " +
                                                 std::to_string(header.height) + " pixels, its calibration says " +
                                                 std::to_string(size->first) + " x " + std::to_string(size->second));
  // Calibrations know nothing of a tag that turns the picture when it is shown.
  const cv::Mat grey = encoded->decode(cv::IMREAD_GRAYSCALE | cv::IMREAD_IGNORE_ORIENTATION);
  cv::Mat read, rgb;
  // Decoded once more, so that the grey ones are the same whoever asks: decoders have their own ways to grey.
  if (colours == Colours::rgb) read = encoded->decode(cv::IMREAD_ANYCOLOR | cv::IMREAD_IGNORE_ORIENTATION);
  if (read.channels() == 3) cv::cvtColor(read, rgb, cv::COLOR_BGR2RGB);
  if (grey.cols != header.width || grey.rows != header.height)
    return fail(ErrorCode::image_unreadable,
                path.string() + " is damaged: it does not decode to the size that its header says");
  return Image{{}, grey.cols, grey.rows, {grey.datastart, grey.dataend}, {rgb.datastart, rgb.dataend}};
}

Result<void> write_image(const std::filesystem::path& path, const Image& image) {
  return write_encoded(
      path, cv::Mat(image.height, image.width, CV_8UC1, const_cast<std::uint8_t*>(image.pixels.data())));  // read only
}

}  // namespace calib
