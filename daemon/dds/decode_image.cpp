#include <algorithm>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>
#include <optional>
#include <span>
#include <string_view>

#include "calib/image_bits.hpp"
#include "calib/image_codec.hpp"
#include "dds/compressed_probe.hpp"
#include "dds/decode.hpp"

namespace calib {
namespace {

constexpr std::uint64_t max_compressed_bytes = 32'000'000;
constexpr int as_it_is = -1, no_colour = -2;

/// How the bytes of an image lie.
enum class Storage {
  bytes,     // one of each channel per pixel
  words,     // two of each
  nv_planes  // a plane of Y, then half as many rows of U and V interleaved
};

/// How an encoding is converted to grey and to RGB: a colour code of OpenCV, or one of those above. Words are scaled to
/// bytes first, for which `opencv_type` is then.
struct Encoding {
  std::string_view name;
  int opencv_type;
  int to_grey, to_rgb;
  Storage storage = Storage::bytes;
};

// OpenCV names a Bayer pattern by the second row's second and third pixel, ROS by the first row's first two.
constexpr Encoding encodings[] = {
    {"mono8", CV_8UC1, as_it_is, no_colour},
    {"8UC1", CV_8UC1, as_it_is, no_colour},
    {"mono16", CV_8UC1, as_it_is, no_colour, Storage::words},
    {"rgb8", CV_8UC3, cv::COLOR_RGB2GRAY, as_it_is},
    {"bgr8", CV_8UC3, cv::COLOR_BGR2GRAY, cv::COLOR_BGR2RGB},
    {"8UC3", CV_8UC3, cv::COLOR_BGR2GRAY, cv::COLOR_BGR2RGB},
    {"rgba8", CV_8UC4, cv::COLOR_RGBA2GRAY, cv::COLOR_RGBA2RGB},
    {"bgra8", CV_8UC4, cv::COLOR_BGRA2GRAY, cv::COLOR_BGRA2RGB},
    {"bayer_rggb8", CV_8UC1, cv::COLOR_BayerBG2GRAY, cv::COLOR_BayerBG2RGB},
    {"bayer_bggr8", CV_8UC1, cv::COLOR_BayerRG2GRAY, cv::COLOR_BayerRG2RGB},
    {"bayer_gbrg8", CV_8UC1, cv::COLOR_BayerGR2GRAY, cv::COLOR_BayerGR2RGB},
    {"bayer_grbg8", CV_8UC1, cv::COLOR_BayerGB2GRAY, cv::COLOR_BayerGB2RGB},
    {"rgb16", CV_8UC3, cv::COLOR_RGB2GRAY, as_it_is, Storage::words},
    {"bgr16", CV_8UC3, cv::COLOR_BGR2GRAY, cv::COLOR_BGR2RGB, Storage::words},
    {"16UC3", CV_8UC3, cv::COLOR_BGR2GRAY, cv::COLOR_BGR2RGB, Storage::words},
    {"bayer_rggb16", CV_8UC1, cv::COLOR_BayerBG2GRAY, cv::COLOR_BayerBG2RGB, Storage::words},
    {"bayer_bggr16", CV_8UC1, cv::COLOR_BayerRG2GRAY, cv::COLOR_BayerRG2RGB, Storage::words},
    {"bayer_gbrg16", CV_8UC1, cv::COLOR_BayerGR2GRAY, cv::COLOR_BayerGR2RGB, Storage::words},
    {"bayer_grbg16", CV_8UC1, cv::COLOR_BayerGB2GRAY, cv::COLOR_BayerGB2RGB, Storage::words},
    {"nv12", CV_8UC1, as_it_is, cv::COLOR_YUV2RGB_NV12, Storage::nv_planes},
    {"nv21", CV_8UC1, as_it_is, cv::COLOR_YUV2RGB_NV21, Storage::nv_planes},
    {"yuv422", CV_8UC2, cv::COLOR_YUV2GRAY_UYVY, cv::COLOR_YUV2RGB_UYVY},
    {"uyvy", CV_8UC2, cv::COLOR_YUV2GRAY_UYVY, cv::COLOR_YUV2RGB_UYVY},
    {"yuv422_yuy2", CV_8UC2, cv::COLOR_YUV2GRAY_YUY2, cv::COLOR_YUV2RGB_YUY2},
    {"yuyv", CV_8UC2, cv::COLOR_YUV2GRAY_YUY2, cv::COLOR_YUV2RGB_YUY2},
};

bool is_depth(std::string_view encoding) { return encoding.starts_with("16UC1") || encoding.starts_with("32FC1"); }

Result<Encoding> find_encoding(std::string_view name) {
  if (is_depth(name))
    return fail(ErrorCode::malformed_depth_encoding, "encoding '" + escape_control(name.substr(0, 32)) +
                                                         "' is a depth image's; configure the camera's image topic");
  std::string names;
  for (const Encoding& encoding : encodings) {
    if (encoding.name == name) return encoding;
    names += (names.empty() ? "" : ", ") + std::string(encoding.name);
  }
  return fail(ErrorCode::malformed_encoding,
              "encoding '" + escape_control(name.substr(0, 32)) + "' is none of " + names);
}

/// Of `row_values` words a row, from `image.step` bytes to the next, to bytes: 0 .. 2^bits - 1 becomes 0 .. 255,
/// rounded to nearest, and what is more becomes 255. Reads bytes, because a row of a padded image may begin at an odd
/// address. Returns the greatest word.
std::uint32_t scale_to_8_bit(const sensor_msgs_msg_dds__Image_& message, std::uint64_t step, std::size_t row_values,
                             int bits, std::uint8_t* out) {
  const int high = message.is_bigendian ? 0 : 1;
  const std::uint32_t most = (1U << bits) - 1;
  std::uint32_t greatest = 0;
  for (std::size_t row = 0; row < message.height; ++row) {
    const std::uint8_t* in = message.data._buffer + row * step;
    for (std::size_t i = 0; i < row_values; ++i, in += 2) {
      const std::uint32_t value = static_cast<std::uint32_t>(in[high]) << 8 | in[1 - high];
      greatest = std::max(greatest, value);
      *out++ = static_cast<std::uint8_t>((std::min(value, most) * 255 + most / 2) / most);
    }
  }
  return greatest;
}

/// Converts into `out`, which has the right size: that of `in`, unless another one is given.
Result<void> convert(const cv::Mat& in, int conversion, int type, std::vector<std::uint8_t>& out,
                     std::optional<ImageSize> size = std::nullopt) {
  try {
    cv::Mat to(size ? size->height : in.rows, size ? size->width : in.cols, type, out.data());
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

Result<std::uint64_t> check_layout(const sensor_msgs_msg_dds__Image_& message, std::uint64_t bytes_per_pixel,
                                   const ImageBound& bound, MessageNotes& notes, std::uint64_t extra_rows) {
  const std::uint64_t pixels = std::uint64_t{message.width} * message.height;
  if (pixels < 1 || pixels > max_image_pixels)
    return fail(ErrorCode::malformed_image_size,
                std::to_string(message.width) + " x " + std::to_string(message.height) + " is outside 1 .. 64 Mpx");
  const std::uint64_t row_bytes = message.width * bytes_per_pixel, rows = message.height + extra_rows;
  const std::uint64_t length = message.data._length;
  const std::string given = "step is " + std::to_string(message.step) + ", and a row has " + std::to_string(row_bytes) +
                            " bytes (" + std::to_string(message.width) + " pixels of " +
                            std::to_string(bytes_per_pixel) + ")";
  const bool fits = message.step >= row_bytes && message.step <= row_bytes + max_row_padding;
  std::uint64_t step = message.step;
  if (!fits && length == rows * row_bytes) {
    step = row_bytes;
    add_remark(notes, ErrorCode::malformed_step, given + "; the data is read as rows without padding");
  }
  const std::string sizes =
      std::to_string(length) + " bytes of data, where step and height need " + std::to_string(step * rows);
  if (step < row_bytes) return fail(ErrorCode::malformed_step, given + ", which is more");
  if (length < step * rows) return fail(ErrorCode::malformed_image_data, sizes);
  if (step > row_bytes + max_row_padding)
    return fail(ErrorCode::malformed_step, given + ": a padding of more than " + std::to_string(max_row_padding));
  if (length > step * rows + max_data_slack)
    return fail(ErrorCode::malformed_image_data,
                sizes + " and " + std::to_string(max_data_slack) + " more are allowed");
  if (const auto fit = bound.check({static_cast<int>(message.width), static_cast<int>(message.height)}); !fit)
    return propagate(fit);
  return step;
}

Result<Image> decode_image(const sensor_msgs_msg_dds__Image_& message, Colour colour, const ImageBound& bound) {
  const auto stamp = decode_stamp(message.header);
  if (!stamp) return propagate(stamp);
  const auto encoding = find_encoding(message.encoding ? message.encoding : "");
  if (!encoding) return propagate(encoding);
  const bool words = encoding->storage == Storage::words, planes = encoding->storage == Storage::nv_planes;
  const auto channels_bytes = static_cast<std::uint64_t>(CV_ELEM_SIZE(encoding->opencv_type));
  Image image{*stamp, static_cast<int>(message.width), static_cast<int>(message.height), {},
              {},     notes_of(message.header)};
  const auto step = check_layout(message, channels_bytes * (words ? 2 : 1), bound, image.notes,
                                 planes ? (std::uint64_t{message.height} + 1) / 2 : 0);
  if (!step) return propagate(step);
  if (planes && (message.width % 2 != 0 || message.height % 2 != 0))
    return fail(ErrorCode::malformed_image_size, std::to_string(message.width) + " x " +
                                                     std::to_string(message.height) + " is odd, and " +
                                                     std::string(encoding->name) + " halves both");

  image.pixels.resize(std::size_t{message.width} * message.height);
  std::vector<std::uint8_t> scaled;
  cv::Mat in(image.height, image.width, encoding->opencv_type, message.data._buffer, *step);
  if (words) {
    const std::size_t row_values = std::size_t{message.width} * channels_bytes;
    const bool grey = encoding->to_grey == as_it_is;
    if (!grey) scaled.resize(row_values * message.height);
    const std::uint32_t greatest = scale_to_8_bit(message, *step, row_values, bound.significant_bits(),
                                                  grey ? image.pixels.data() : scaled.data());
    if (auto fewer = fewer_bits(greatest, bound.significant_bits()))
      add_remark(image.notes, ErrorCode::image_bits, *std::move(fewer));
    if (grey) return image;
    in = cv::Mat(image.height, image.width, encoding->opencv_type, scaled.data());
  }
  if (const auto made = convert(in, encoding->to_grey, CV_8UC1, image.pixels); !made) return propagate(made);
  if (colour == Colour::none || encoding->to_rgb == no_colour) return image;
  image.rgb.resize(3 * image.pixels.size());
  if (planes) in = cv::Mat(image.height * 3 / 2, image.width, CV_8UC1, message.data._buffer, *step);
  if (const auto made = convert(in, encoding->to_rgb, CV_8UC3, image.rgb, ImageSize{image.width, image.height}); !made)
    return propagate(made);
  return image;
}

Result<Image> decode_compressed_image(const sensor_msgs_msg_dds__CompressedImage_& message, Colour colour,
                                      const ImageBound& bound) {
  const auto stamp = decode_stamp(message.header);
  if (!stamp) return propagate(stamp);
  if (message.format && is_depth(message.format))
    return fail(ErrorCode::malformed_depth_encoding,
                "format '" + escape_control(std::string_view(message.format).substr(0, 32)) +
                    "' is a depth image's; configure the camera's image topic");
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
  Image image{*stamp, width,
              height, std::vector<std::uint8_t>(static_cast<std::size_t>(width) * height),
              {},     notes_of(message.header)};
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
