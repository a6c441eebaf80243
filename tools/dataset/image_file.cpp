#include "dataset/image_file.hpp"

#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

namespace calib {

Result<Image> read_image(const std::filesystem::path& path, Colours colours) {
  cv::Mat grey, read, rgb;
  try {
    // Calibrations know nothing of a tag that turns the picture when it is shown.
    grey = cv::imread(path.string(), cv::IMREAD_GRAYSCALE | cv::IMREAD_IGNORE_ORIENTATION);
    // Read once more, so that the grey ones are the same whoever asks: decoders have their own ways to grey.
    if (colours == Colours::rgb) read = cv::imread(path.string(), cv::IMREAD_ANYCOLOR | cv::IMREAD_IGNORE_ORIENTATION);
    if (read.channels() == 3) cv::cvtColor(read, rgb, cv::COLOR_BGR2RGB);
  } catch (const cv::Exception&) {  // a damaged header; reported below like any other unreadable file
  }
  if (grey.empty()) return fail("image_unreadable", path.string() + " is missing or not an image");
  return Image{{}, grey.cols, grey.rows, {grey.datastart, grey.dataend}, {rgb.datastart, rgb.dataend}};
}

Result<void> write_image(const std::filesystem::path& path, const Image& image) {
  const cv::Mat pixels(image.height, image.width, CV_8UC1, const_cast<std::uint8_t*>(image.pixels.data()));
  bool written = false;
  try {
    written = cv::imwrite(path.string(), pixels);
  } catch (const cv::Exception&) {  // no such folder, or not an extension that can be written
  }
  if (!written) return fail("write_failed", path.string() + " cannot be written");
  return {};
}

}  // namespace calib
