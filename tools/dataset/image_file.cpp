#include "dataset/image_file.hpp"

#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "calib/image_bits.hpp"
#include "dataset/encoded_image.hpp"

namespace calib {
namespace {

/// To 8 bits. Calibrations know nothing of a tag that turns the picture when it is shown.
cv::Mat decode(const EncodedImage& encoded, int colour_flag, int bits, MessageNotes* notes) {
  const int flags = colour_flag | cv::IMREAD_IGNORE_ORIENTATION;
  const cv::Mat deep = encoded.decode(flags | cv::IMREAD_ANYDEPTH);
  if (deep.depth() == CV_8U) return deep;
  if (deep.depth() != CV_16U) return encoded.decode(flags);
  double greatest = 0;
  cv::minMaxIdx(deep.reshape(1), nullptr, &greatest);
  if (auto fewer = fewer_bits(static_cast<std::uint32_t>(greatest), bits); fewer && notes != nullptr)
    notes->remarks.push_back({ErrorCode::image_bits, *std::move(fewer)});
  if (bits == 16) return encoded.decode(flags);
  cv::Mat scaled;
  deep.convertTo(scaled, CV_8U, 255.0 / ((1 << bits) - 1));
  return scaled;
}

}  // namespace

Result<Image> read_image(const std::filesystem::path& path, Colours colours, std::optional<std::pair<int, int>> size,
                         int bits) {
  const auto encoded = EncodedImage::read(path, ErrorCode::image_unreadable);
  if (!encoded) return propagate(encoded);
  const ImageHeader& header = encoded->header();
  if (size && (header.width != size->first || header.height != size->second))
    return fail(ErrorCode::image_unreadable, path.string() + " is " + std::to_string(header.width) + " x " +
                                                 std::to_string(header.height) + " pixels, its calibration says " +
                                                 std::to_string(size->first) + " x " + std::to_string(size->second));
  MessageNotes notes;
  const cv::Mat grey = decode(*encoded, cv::IMREAD_GRAYSCALE, bits, &notes);
  cv::Mat read, rgb;
  // Decoded once more, so that the grey ones are the same whoever asks: decoders have their own ways to grey.
  if (colours == Colours::rgb) read = decode(*encoded, cv::IMREAD_ANYCOLOR, bits, nullptr);
  if (read.channels() == 3) cv::cvtColor(read, rgb, cv::COLOR_BGR2RGB);
  if (grey.cols != header.width || grey.rows != header.height)
    return fail(ErrorCode::image_unreadable,
                path.string() + " is damaged: it does not decode to the size that its header says");
  return Image{
      {}, grey.cols, grey.rows, {grey.datastart, grey.dataend}, {rgb.datastart, rgb.dataend}, std::move(notes)};
}

Result<void> write_image(const std::filesystem::path& path, const Image& image) {
  return write_encoded(
      path, cv::Mat(image.height, image.width, CV_8UC1, const_cast<std::uint8_t*>(image.pixels.data())));  // read only
}

}  // namespace calib
