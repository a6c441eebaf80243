#include <algorithm>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <optional>
#include <span>
#include <string_view>

#include "dds/decode.hpp"

namespace calib {
namespace {

constexpr std::size_t max_compressed_bytes = 32'000'000;
constexpr int as_it_is = -1, scale_grey16 = -2, no_colour = -3;

/// How an encoding becomes grey and RGB: an OpenCV colour code, or one of those above.
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
    return fail("malformed:depth_encoding", "this topic carries a depth image; configure the camera's image topic");
  for (const Encoding& encoding : encodings)
    if (encoding.name == name) return encoding;
  return fail("malformed:encoding", "encoding '" + std::string(name.substr(0, 32)) + "' is not supported");
}

/// By bytes, because a row of a padded image may begin at an odd address. 65535 becomes 255, rounded to
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

/// Into `out`, which has the size already.
Result<void> convert(const cv::Mat& in, int conversion, int type, std::vector<std::uint8_t>& out) {
  try {
    cv::Mat to(in.rows, in.cols, type, out.data());
    if (conversion == as_it_is)
      in.copyTo(to);
    else
      cv::cvtColor(in, to, conversion);
    if (to.data != out.data()) return fail("malformed:image_data", "the conversion changed its size");
  } catch (const cv::Exception& e) {
    return fail("malformed:image_data", "OpenCV refuses it: " + e.err);
  }
  return {};
}

struct Size {
  std::int64_t width = 0, height = 0;
  [[nodiscard]] bool in_bounds() const {
    return width >= 1 && height >= 1 && width <= max_image_pixels && height <= max_image_pixels / width;
  }
};

using Bytes = std::span<const std::uint8_t>;

std::int64_t big_endian(Bytes bytes) {
  std::int64_t value = 0;
  for (const std::uint8_t byte : bytes) value = value << 8 | byte;
  return value;
}

/// From IHDR, which is always the first chunk.
std::optional<Size> png_size(Bytes bytes) {
  if (bytes.size() < 24 || big_endian(bytes.subspan(12, 4)) != 0x49484452) return std::nullopt;
  return Size{big_endian(bytes.subspan(16, 4)), big_endian(bytes.subspan(20, 4))};
}

/// From the first start-of-frame segment, skipping the segments before it (a thumbnail lies inside one of
/// those).
std::optional<Size> jpeg_size(Bytes bytes) {
  std::size_t at = 2;
  while (at + 9 <= bytes.size()) {
    if (bytes[at] != 0xFF) return std::nullopt;
    const int marker = bytes[at + 1];
    if (marker == 0xFF) {  // fill byte
      ++at;
      continue;
    }
    const bool start_of_frame = marker >= 0xC0 && marker <= 0xCF && marker != 0xC4 && marker != 0xC8 && marker != 0xCC;
    if (start_of_frame) return Size{big_endian(bytes.subspan(at + 7, 2)), big_endian(bytes.subspan(at + 5, 2))};
    const std::int64_t length = big_endian(bytes.subspan(at + 2, 2));
    if (length < 2) return std::nullopt;
    at += 2 + static_cast<std::size_t>(length);
  }
  return std::nullopt;
}

/// libjpeg takes a JPEG that was cut short and paints the rest grey, with no more than a warning to standard
/// error. Some cameras pad behind the end marker.
bool jpeg_is_whole(Bytes bytes) {
  while (!bytes.empty() && bytes.back() == 0) bytes = bytes.first(bytes.size() - 1);
  return bytes.size() >= 2 && bytes[bytes.size() - 2] == 0xFF && bytes.back() == 0xD9;
}

Result<Size> probe(Bytes bytes) {
  constexpr std::uint8_t png[] = {0x89, 'P', 'N', 'G', '\r', '\n', 0x1A, '\n'};
  constexpr std::uint8_t jpeg[] = {0xFF, 0xD8, 0xFF};
  const bool is_png = bytes.size() >= 8 && std::ranges::equal(bytes.first(8), png);
  const bool is_jpeg = bytes.size() >= 3 && std::ranges::equal(bytes.first(3), jpeg);
  if (!is_png && !is_jpeg) return fail("malformed:compressed_format", "data begins neither as a JPEG nor as a PNG");
  const std::optional<Size> size = is_png ? png_size(bytes) : jpeg_size(bytes);
  if (!size || !size->in_bounds())
    return fail("malformed:compressed_dimensions", "its header gives no size in 1 .. 64 Mpx");
  if (is_jpeg && !jpeg_is_whole(bytes)) return fail("malformed:compressed_data", "the JPEG is cut short");
  return *size;
}

}  // namespace

Result<void> check_layout(const sensor_msgs_msg_dds__Image_& message, std::uint64_t bytes_per_pixel) {
  if (!Size{message.width, message.height}.in_bounds())
    return fail("malformed:image_size",
                std::to_string(message.width) + " x " + std::to_string(message.height) + " is outside 1 .. 64 Mpx");
  if (message.step < message.width * bytes_per_pixel)
    return fail("malformed:step", "step " + std::to_string(message.step) + " is less than a row of " +
                                      std::to_string(bytes_per_pixel) + " bytes per pixel");
  if (message.data._length < std::uint64_t{message.step} * message.height)
    return fail("malformed:image_data", "fewer bytes of data than step * height");
  return {};
}

Result<Image> decode_image(const sensor_msgs_msg_dds__Image_& message, Colour colour) {
  const auto stamp = decode_stamp(message.header);
  if (!stamp) return tl::unexpected(stamp.error());
  const auto encoding = find_encoding(message.encoding ? message.encoding : "");
  if (!encoding) return tl::unexpected(encoding.error());
  const auto size = static_cast<std::uint64_t>(CV_ELEM_SIZE(encoding->opencv_type));
  if (const auto sound = check_layout(message, size); !sound) return tl::unexpected(sound.error());

  Image image{*stamp, static_cast<int>(message.width), static_cast<int>(message.height), {}};
  image.pixels.resize(std::size_t{message.width} * message.height);
  if (encoding->to_grey == scale_grey16) {
    scale_to_8_bit(message, image);
    return image;
  }
  const cv::Mat in(image.height, image.width, encoding->opencv_type, message.data._buffer, message.step);
  if (const auto made = convert(in, encoding->to_grey, CV_8UC1, image.pixels); !made)
    return tl::unexpected(made.error());
  if (colour == Colour::none || encoding->to_rgb == no_colour) return image;
  image.rgb.resize(3 * image.pixels.size());
  if (const auto made = convert(in, encoding->to_rgb, CV_8UC3, image.rgb); !made) return tl::unexpected(made.error());
  return image;
}

Result<Image> decode_compressed_image(const sensor_msgs_msg_dds__CompressedImage_& message, Colour colour) {
  const auto stamp = decode_stamp(message.header);
  if (!stamp) return tl::unexpected(stamp.error());
  if (message.format && is_depth(message.format))
    return fail("malformed:depth_encoding", "this topic carries a depth image; configure the camera's image topic");
  const Bytes bytes(message.data._buffer, message.data._length);
  if (bytes.empty() || bytes.size() > max_compressed_bytes)
    return fail("malformed:compressed_size", std::to_string(bytes.size()) + " bytes are outside 1 .. 32 MB");
  const auto size = probe(bytes);
  if (!size) return tl::unexpected(size.error());

  cv::Mat picture;
  try {
    const cv::Mat in(1, static_cast<int>(bytes.size()), CV_8UC1, message.data._buffer);
    const auto wanted = colour == Colour::rgb ? cv::IMREAD_COLOR : cv::IMREAD_GRAYSCALE;
    picture = cv::imdecode(in, wanted | cv::IMREAD_IGNORE_ORIENTATION);
  } catch (const cv::Exception& e) {
    return fail("malformed:compressed_data", "OpenCV refuses it: " + e.err);
  }
  if (picture.empty() || picture.cols != size->width || picture.rows != size->height)
    return fail("malformed:compressed_data", "it does not decode to the size that its header gives");
  Image image{*stamp, picture.cols, picture.rows, std::vector<std::uint8_t>(picture.total())};
  const bool grey_only = colour == Colour::none;
  if (const auto made = convert(picture, grey_only ? as_it_is : cv::COLOR_BGR2GRAY, CV_8UC1, image.pixels); !made)
    return tl::unexpected(made.error());
  if (grey_only) return image;
  image.rgb.resize(3 * image.pixels.size());
  if (const auto made = convert(picture, cv::COLOR_BGR2RGB, CV_8UC3, image.rgb); !made)
    return tl::unexpected(made.error());
  return image;
}

}  // namespace calib
