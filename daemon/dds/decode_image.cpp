#include <algorithm>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>
#include <span>
#include <string_view>

#include "calib/image_codec.hpp"
#include "dds/compressed_probe.hpp"
#include "dds/decode.hpp"

namespace calib {
namespace {

constexpr std::uint64_t max_compressed_bytes = 32'000'000;
constexpr int as_it_is = -1, scale_grey16 = -2, no_colour = -3;

/// How an encoding is converted to grey and to RGB: a colour code of OpenCV, or one of those above.
struct Encoding {
  std::string_view name;
  int opencv_type;
  int to_grey, to_rgb;
};

// OpenCV names a Bayer pattern by the second row's second and third pixel, ROS by the first row's first two.
constexpr Encoding encodings[] = {
    {"mono8", CV_8UC1, as_it_is, no_colour},
    {"8UC1", CV_8UC1, as_it_is, no_colour},
    {"mono16", CV_16UC1, scale_grey16, no_colour},
    {"rgb8", CV_8UC3, cv::COLOR_RGB2GRAY, as_it_is},
    {"bgr8", CV_8UC3, cv::COLOR_BGR2GRAY, cv::COLOR_BGR2RGB},
    {"8UC3", CV_8UC3, cv::COLOR_BGR2GRAY, cv::COLOR_BGR2RGB},
    {"rgba8", CV_8UC4, cv::COLOR_RGBA2GRAY, cv::COLOR_RGBA2RGB},
    {"bgra8", CV_8UC4, cv::COLOR_BGRA2GRAY, cv::COLOR_BGRA2RGB},
    {"bayer_rggb8", CV_8UC1, cv::COLOR_BayerBG2GRAY, cv::COLOR_BayerBG2RGB},
    {"bayer_bggr8", CV_8UC1, cv::COLOR_BayerRG2GRAY, cv::COLOR_BayerRG2RGB},
    {"bayer_gbrg8", CV_8UC1, cv::COLOR_BayerGR2GRAY, cv::COLOR_BayerGR2RGB},
    {"bayer_grbg8", CV_8UC1, cv::COLOR_BayerGB2GRAY, cv::COLOR_BayerGB2RGB},
    {"yuv422", CV_8UC2, cv::COLOR_YUV2GRAY_UYVY, cv::COLOR_YUV2RGB_UYVY},
    {"uyvy", CV_8UC2, cv::COLOR_YUV2GRAY_UYVY, cv::COLOR_YUV2RGB_UYVY},
    {"yuv422_yuy2", CV_8UC2, cv::COLOR_YUV2GRAY_YUY2, cv::COLOR_YUV2RGB_YUY2},
    {"yuyv", CV_8UC2, cv::COLOR_YUV2GRAY_YUY2, cv::COLOR_YUV2RGB_YUY2},
};

bool is_depth(std::string_view encoding) { return encoding.starts_with("16UC1") || encoding.starts_with("32FC1"); }

Result<Encoding> find_encoding(std::string_view name) {
  if (is_depth(name))
    return fail(ErrorCode::malformed_depth_encoding,
                "this topic carries a depth image; configure the camera's image topic");
  for (const Encoding& encoding : encodings)
    if (encoding.name == name) return encoding;
  return fail(ErrorCode::malformed_encoding, "encoding '" + std::string(name.substr(0, 32)) + "' is not supported");
}

/// Reads bytes, because a row of a padded image may begin at an odd address. 0 .. 65535 becomes 0 .. 255, rounded to
/// nearest.
void scale_to_8_bit(const sensor_msgs_msg_dds__Image_& message, Image& image) {
  const int high = message.is_bigendian ? 0 : 1;
  auto* out = image.pixels.data();
  for (std::size_t row = 0; row < message.height; ++row) {
    const std::uint8_t* in = message.data._buffer + row * message.step;
    for (std::size_t column = 0; column < message.width; ++column, in += 2) {
      const int value = in[high] << 8 | in[1 - high];
      *out++ = static_cast<std::uint8_t>((value + 128) / 257);
    }
  }
}

/// Converts into `out`, which has the right size.
Result<void> convert(const cv::Mat& in, int conversion, int type, std::vector<std::uint8_t>& out) {
  try {
    cv::Mat to(in.rows, in.cols, type, out.data());
    if (conversion == as_it_is)
      in.copyTo(to);
    else
      cv::cvtColor(in, to, conversion);
    if (to.data != out.data())
      return fail(ErrorCode::malformed_image_data, "the conversion changes the size of the image");
  } catch (const cv::Exception& e) {
    if (e.code == cv::Error::StsNoMem) return fail(ErrorCode::out_of_memory, "there is no memory for the image");
    return fail(ErrorCode::malformed_image_data, "OpenCV cannot convert it: " + e.err);
  }
  return {};
}

}  // namespace

Result<void> check_layout(const sensor_msgs_msg_dds__Image_& message, std::uint64_t bytes_per_pixel,
                          const ImageBound& bound) {
  const std::uint64_t pixels = std::uint64_t{message.width} * message.height;
  if (pixels < 1 || pixels > max_image_pixels)
    return fail(ErrorCode::malformed_image_size,
                std::to_string(message.width) + " x " + std::to_string(message.height) + " is outside 1 .. 64 Mpx");
  if (message.step < message.width * bytes_per_pixel)
    return fail(ErrorCode::malformed_step, "step " + std::to_string(message.step) + " is less than a row of " +
                                               std::to_string(bytes_per_pixel) + " bytes per pixel");
  if (message.data._length < std::uint64_t{message.step} * message.height)
    return fail(ErrorCode::malformed_image_data, "fewer bytes of data than step * height");
  if (message.step > message.width * bytes_per_pixel + max_row_padding)
    return fail(ErrorCode::malformed_step, "rows are padded by more than 4096 bytes");
  if (message.data._length > std::uint64_t{message.step} * message.height + max_data_slack)
    return fail(ErrorCode::malformed_image_data, "more bytes of data than step * height");
  return bound.check({static_cast<int>(message.width), static_cast<int>(message.height)});
}

Result<Image> decode_image(const sensor_msgs_msg_dds__Image_& message, Colour colour, const ImageBound& bound) {
  const auto stamp = decode_stamp(message.header);
  if (!stamp) return propagate(stamp);
  const auto encoding = find_encoding(message.encoding ? message.encoding : "");
  if (!encoding) return propagate(encoding);
  const auto size = static_cast<std::uint64_t>(CV_ELEM_SIZE(encoding->opencv_type));
  if (const auto sound = check_layout(message, size, bound); !sound) return propagate(sound);

  Image image{*stamp, static_cast<int>(message.width), static_cast<int>(message.height), {}};
  image.pixels.resize(std::size_t{message.width} * message.height);
  if (encoding->to_grey == scale_grey16) {
    scale_to_8_bit(message, image);
    return image;
  }
  const cv::Mat in(image.height, image.width, encoding->opencv_type, message.data._buffer, message.step);
  if (const auto made = convert(in, encoding->to_grey, CV_8UC1, image.pixels); !made) return propagate(made);
  if (colour == Colour::none || encoding->to_rgb == no_colour) return image;
  image.rgb.resize(3 * image.pixels.size());
  if (const auto made = convert(in, encoding->to_rgb, CV_8UC3, image.rgb); !made) return propagate(made);
  return image;
}

Result<Image> decode_compressed_image(const sensor_msgs_msg_dds__CompressedImage_& message, Colour colour,
                                      const ImageBound& bound) {
  const auto stamp = decode_stamp(message.header);
  if (!stamp) return propagate(stamp);
  if (message.format && is_depth(message.format))
    return fail(ErrorCode::malformed_depth_encoding,
                "this topic carries a depth image; configure the camera's image topic");
  const std::span<const std::uint8_t> bytes(message.data._buffer, message.data._length);
  if (bytes.empty()) return fail(ErrorCode::malformed_compressed_size, "there are no bytes");
  const auto header = probe_compressed(bytes);
  if (!header) return propagate(header);
  if (const auto fits = bound.check(header->size); !fits) return propagate(fits);
  const std::uint64_t most =
      std::min(max_compressed_bytes, std::uint64_t{4} * header->size.width * header->size.height + max_data_slack);
  if (bytes.size() > most)
    return fail(ErrorCode::malformed_compressed_size, std::to_string(bytes.size()) + " bytes where " +
                                                          std::to_string(most) +
                                                          " are allowed for an image of its size");
  if (const auto sound = check_compressed(bytes, *header); !sound) return propagate(sound);

  const auto [width, height] = header->size;
  Image image{*stamp, width, height, std::vector<std::uint8_t>(static_cast<std::size_t>(width) * height)};
  const bool grey_only = colour == Colour::none;
  if (!grey_only) image.rgb.resize(3 * image.pixels.size());
  const auto decoded = decode_pixels(bytes, header->compression, {width, height, grey_only ? 1 : 3},
                                     grey_only ? image.pixels : image.rgb);
  if (!decoded) return propagate(decoded);
  if (grey_only) return image;
  const cv::Mat rgb(height, width, CV_8UC3, image.rgb.data());
  if (const auto made = convert(rgb, cv::COLOR_RGB2GRAY, CV_8UC1, image.pixels); !made) return propagate(made);
  return image;
}

}  // namespace calib
