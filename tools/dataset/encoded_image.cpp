#include "dataset/encoded_image.hpp"

#include <opencv2/imgcodecs.hpp>
#include <vector>

#include "calib/file.hpp"

namespace calib {

Result<EncodedImage> EncodedImage::read(const std::filesystem::path& path, ErrorCode code) {
  constexpr std::uint64_t most_bytes = 256 << 20;
  auto bytes = read_regular_file(path, most_bytes);
  if (!bytes) return fail(code, bytes.error().context);
  const auto header = read_image_header(*bytes);
  if (!header) return fail(code, path.string() + " is not an image (PNG, JPEG, TIFF, BMP, PNM, PFM)");
  if (!header->complete) return fail(code, path.string() + " is cut short: no end of image follows its pixels");
  if (!header->in_bounds())
    return fail(code, path.string() + " is " + std::to_string(header->width) + " x " + std::to_string(header->height) +
                          " pixels in " + std::to_string(header->scans) + " scans; up to 64 Mpx and 100 are read");
  return EncodedImage(*std::move(bytes), *header);
}

cv::Mat EncodedImage::decode(int flags) const {
  try {
    const cv::Mat in(1, static_cast<int>(bytes_.size()), CV_8UC1, const_cast<char*>(bytes_.data()));  // read only
    return cv::imdecode(in, flags);
  } catch (const cv::Exception&) {
    return {};
  }
}

Result<void> write_encoded(const std::filesystem::path& path, const cv::Mat& pixels) {
  try {
    std::vector<std::uint8_t> encoded;
    if (cv::imencode(path.extension().string(), pixels, encoded))
      return replace_file(path, {reinterpret_cast<const char*>(encoded.data()), encoded.size()});
  } catch (const cv::Exception&) {  // not an extension that can be written
  }
  return fail(ErrorCode::write_failed, path.string() + " cannot be written");
}

}  // namespace calib
