#pragma once

#include <filesystem>
#include <opencv2/core.hpp>
#include <optional>
#include <string>

#include "calib/image_header.hpp"
#include "calib/result.hpp"

namespace calib {

/// The bytes of an image whose header promises that decoding them takes bounded memory and time.
class EncodedImage {
 public:
  /// Fails with `code`: no regular file of up to 256 MiB, no format that `read_image_header` knows, over 64 Mpx.
  [[nodiscard]] static Result<EncodedImage> read(const std::filesystem::path& path, ErrorCode code);
  [[nodiscard]] const ImageHeader& header() const { return header_; }
  /// `flags` as of cv::imread. Empty when the image is damaged.
  [[nodiscard]] cv::Mat decode(int flags) const;

 private:
  EncodedImage(std::string bytes, const ImageHeader& header) : bytes_(std::move(bytes)), header_(header) {}
  std::string bytes_;
  ImageHeader header_;
};

/// Writes an image of the format that the extension says. Fails with `write_failed`.
[[nodiscard]] Result<void> write_encoded(const std::filesystem::path& path, const cv::Mat& pixels);

}  // namespace calib
