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
  bytes,       // one of each channel per pixel
  words,       // two of each
  nv_planes,   // a plane of Y, then half as many rows of U and V interleaved
  planes_420,  // a plane of Y, then those of U and V, each of half the width and height
  nv_444       // a plane of Y, then U and V interleaved, each of its size
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
    {"8UC4", CV_8UC4, cv::COLOR_BGRA2GRAY, cv::COLOR_BGRA2RGB},
    {"bayer_rggb8", CV_8UC1, cv::COLOR_BayerBG2GRAY, cv::COLOR_BayerBG2RGB},
    {"bayer_bggr8", CV_8UC1, cv::COLOR_BayerRG2GRAY, cv::COLOR_BayerRG2RGB},
    {"bayer_gbrg8", CV_8UC1, cv::COLOR_BayerGR2GRAY, cv::COLOR_BayerGR2RGB},
    {"bayer_grbg8", CV_8UC1, cv::COLOR_BayerGB2GRAY, cv::COLOR_BayerGB2RGB},
    {"rgb16", CV_8UC3, cv::COLOR_RGB2GRAY, as_it_is, Storage::words},
    {"bgr16", CV_8UC3, cv::COLOR_BGR2GRAY, cv::COLOR_BGR2RGB, Storage::words},
    {"16UC3", CV_8UC3, cv::COLOR_BGR2GRAY, cv::COLOR_BGR2RGB, Storage::words},
    {"rgba16", CV_8UC4, cv::COLOR_RGBA2GRAY, cv::COLOR_RGBA2RGB, Storage::words},
    {"bgra16", CV_8UC4, cv::COLOR_BGRA2GRAY, cv::COLOR_BGRA2RGB, Storage::words},
    {"16UC4", CV_8UC4, cv::COLOR_BGRA2GRAY, cv::COLOR_BGRA2RGB, Storage::words},
    {"bayer_rggb16", CV_8UC1, cv::COLOR_BayerBG2GRAY, cv::COLOR_BayerBG2RGB, Storage::words},
    {"bayer_bggr16", CV_8UC1, cv::COLOR_BayerRG2GRAY, cv::COLOR_BayerRG2RGB, Storage::words},
    {"bayer_gbrg16", CV_8UC1, cv::COLOR_BayerGR2GRAY, cv::COLOR_BayerGR2RGB, Storage::words},
    {"bayer_grbg16", CV_8UC1, cv::COLOR_BayerGB2GRAY, cv::COLOR_BayerGB2RGB, Storage::words},
    {"nv12", CV_8UC1, as_it_is, cv::COLOR_YUV2RGB_NV12, Storage::nv_planes},
    {"nv21", CV_8UC1, as_it_is, cv::COLOR_YUV2RGB_NV21, Storage::nv_planes},
    {"nv24", CV_8UC1, as_it_is, as_it_is, Storage::nv_444},
    {"yuv420", CV_8UC1, as_it_is, cv::COLOR_YUV2RGB_I420, Storage::planes_420},
    {"i420", CV_8UC1, as_it_is, cv::COLOR_YUV2RGB_I420, Storage::planes_420},
    {"yv12", CV_8UC1, as_it_is, cv::COLOR_YUV2RGB_YV12, Storage::planes_420},
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

/// image_transport compresses a Bayer image as it is, and then names no encoding behind the word "compressed". Nothing
/// where the format says something else.
const Encoding* mosaic_of(std::string_view format) {
  constexpr std::string_view compressed = "compressed";
  const std::string_view name = format.substr(0, format.find(';'));
  const std::size_t word = format.find(compressed);
  if (!name.starts_with("bayer_") || word == std::string_view::npos) return nullptr;
  const std::string_view made = format.substr(word + compressed.size());
  if (made.find_first_not_of(' ') != std::string_view::npos && made.find(name) == std::string_view::npos)
    return nullptr;
  const auto* const found = std::ranges::find(encodings, name, &Encoding::name);
  return found == std::end(encodings) ? nullptr : found;
}

/// Rows that follow those of Y, as long as they are.
std::uint64_t extra_rows(Storage storage, std::uint64_t height) {
  if (storage == Storage::nv_444) return 2 * height;
  return storage == Storage::nv_planes || storage == Storage::planes_420 ? (height + 1) / 2 : 0;
}

/// Of `row_values` words a row, from `image.step` bytes to the next, to bytes: 0 .. 2^bits - 1 becomes 0 .. 255,
/// rounded to nearest, and what is more becomes 255. Reads bytes, because a row of a padded image may begin at an odd
/// address. Returns the greatest word.
struct Words {
  const std::uint8_t* bytes;
  std::size_t rows;
  std::uint64_t step;
  bool is_bigendian;
};
std::uint32_t scale_to_8_bit(const Words& words, std::size_t row_values, int bits, std::uint8_t* out) {
  const int high = words.is_bigendian ? 0 : 1;
  const std::uint32_t most = (1U << bits) - 1;
  std::uint32_t greatest = 0;
  for (std::size_t row = 0; row < words.rows; ++row) {
    const std::uint8_t* in = words.bytes + row * words.step;
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

/// Planes of U and V whose rows are half as long, padding included, put together without padding, as OpenCV takes them.
std::vector<std::uint8_t> packed_planes(const std::uint8_t* data, std::uint64_t step, int width, int height) {
  const auto w = static_cast<std::size_t>(width), h = static_cast<std::size_t>(height);
  std::vector<std::uint8_t> packed;
  packed.reserve(w * h * 3 / 2);
  for (std::size_t row = 0; row < h; ++row, data += step) packed.insert(packed.end(), data, data + w);
  for (std::size_t row = 0; row < h; ++row, data += step / 2) packed.insert(packed.end(), data, data + w / 2);
  return packed;
}

/// By the weights of ITU-R BT.601 for video levels, as OpenCV has them for the other YUV encodings.
void rgb_of_nv24(const std::uint8_t* data, std::uint64_t step, Image& image) {
  const auto width = static_cast<std::size_t>(image.width), height = static_cast<std::size_t>(image.height);
  const auto byte = [](double value) { return cv::saturate_cast<std::uint8_t>(value); };
  std::uint8_t* out = image.rgb.data();
  for (std::size_t row = 0; row < height; ++row)
    for (std::size_t column = 0; column < width; ++column) {
      const std::uint8_t* uv = data + step * height + 2 * step * row + 2 * column;
      const double y = 1.164 * (std::max<int>(data[step * row + column], 16) - 16);
      const double u = uv[0] - 128.0, v = uv[1] - 128.0;
      *out++ = byte(y + 1.596 * v);
      *out++ = byte(y - 0.813 * v - 0.391 * u);
      *out++ = byte(y + 2.018 * u);
    }
}

/// Some drivers write buffers whose width and height are rounded up, and a step without that. Nothing where the data is
/// not exactly such a buffer.
std::optional<std::uint64_t> step_of_rounded_buffer(const sensor_msgs_msg_dds__Image_& message,
                                                    std::uint64_t bytes_per_pixel) {
  const auto rounded = [](std::uint64_t value, std::uint64_t to) { return (value + to - 1) / to * to; };
  for (const std::uint64_t across : {16, 32, 64, 128})
    for (const std::uint64_t down : {1, 2, 4, 8, 16, 32}) {
      const std::uint64_t step = rounded(message.width, across) * bytes_per_pixel;
      if (step > message.width * bytes_per_pixel && step * rounded(message.height, down) == message.data._length)
        return step;
    }
  return std::nullopt;
}

/// Which number of bytes a pixel the data would be right for; empty where there is none.
std::string bytes_that_fit(const sensor_msgs_msg_dds__Image_& message, std::uint64_t bytes_per_pixel) {
  const std::uint64_t pixels = std::uint64_t{message.width} * message.height;
  const std::uint64_t fitting = message.data._length / pixels;
  if (fitting == 0 || fitting > 8 || fitting == bytes_per_pixel || fitting * pixels != message.data._length) return "";
  return "; that is " + std::to_string(fitting) + " a pixel, where " + escape_control(message.encoding) + " has " +
         std::to_string(bytes_per_pixel) + ": is the encoding right?";
}

/// In YUV 4:2:2 every second byte is brightness, which varies more than colour. Nothing where it does, by far.
std::optional<std::string> other_byte_order(const sensor_msgs_msg_dds__Image_& message, std::uint64_t step,
                                            bool brightness_first) {
  double sums[2] = {}, squares[2] = {}, count = 0;
  for (std::uint32_t row = 0; row < message.height; row += 1 + message.height / 64) {
    const std::uint8_t* const bytes = message.data._buffer + row * step;
    for (std::uint32_t i = 0; i < message.width; ++i, ++count)
      for (const int half : {0, 1}) {
        const double value = bytes[2 * i + half];
        sums[half] += value, squares[half] += value * value;
      }
  }
  const auto variance = [&](int half) { return squares[half] / count - sums[half] / count * (sums[half] / count); };
  const double brightness = variance(brightness_first ? 0 : 1), colour = variance(brightness_first ? 1 : 0);
  if (!(colour > 100) || colour < 9 * brightness) return std::nullopt;
  return std::string("encoding '") + message.encoding +
         "' has brightness in bytes that vary less than those of colour" + "; the driver may publish " +
         (brightness_first ? "uyvy (yuv422)" : "yuyv (yuv422_yuy2)") + " under that name";
}

/// Grey or RGB, in bytes.
Result<std::vector<std::uint8_t>> decode_values(std::span<const std::uint8_t> bytes, const CompressedHeader& header,
                                                int channels, const ImageBound& bound, MessageNotes& notes) {
  const bool words = header.bits == 16;
  const PixelLayout layout{header.size.width, header.size.height, channels, words};
  std::vector<std::uint8_t> values(layout.bytes());
  if (const auto decoded = decode_pixels(bytes, header.compression, layout, values); !decoded)
    return propagate(decoded);
  if (!words) return values;
  std::vector<std::uint8_t> scaled(values.size() / 2);
  const auto height = static_cast<std::size_t>(layout.height);
  const std::uint32_t greatest = scale_to_8_bit({values.data(), height, layout.row_bytes(), true},
                                                scaled.size() / height, bound.significant_bits(), scaled.data());
  // Without the key as every decoder of PNG reduces them: by their high byte.
  if (bound.significant_bits() == 16)
    for (std::size_t i = 0; i < scaled.size(); ++i) scaled[i] = values[2 * i];
  if (auto fewer = fewer_bits(greatest, bound.significant_bits()))
    add_remark(notes, ErrorCode::image_bits, *std::move(fewer));
  return scaled;
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
  bool rounded_buffer = false;
  if (fits && step == row_bytes && length > rows * row_bytes && extra_rows == 0)
    if (const auto rounded = step_of_rounded_buffer(message, bytes_per_pixel)) {
      rounded_buffer = true;
      step = *rounded;
      add_remark(notes, ErrorCode::malformed_step,
                 given + "; the data is read in rows of " + std::to_string(step) +
                     " bytes, of which it is as long as " + std::to_string(length / step));
    }
  if (!fits && length == rows * row_bytes) {
    step = row_bytes;
    add_remark(notes, ErrorCode::malformed_step, given + "; the data is read as rows without padding");
  }
  const std::string sizes =
      std::to_string(length) + " bytes of data, where step and height need " + std::to_string(step * rows);
  if (step < row_bytes) return fail(ErrorCode::malformed_step, given + ", which is more");
  if (length < step * rows)
    return fail(ErrorCode::malformed_image_data, sizes + bytes_that_fit(message, bytes_per_pixel));
  if (step > row_bytes + max_row_padding)
    return fail(ErrorCode::malformed_step, given + ": a padding of more than " + std::to_string(max_row_padding));
  if (length > step * rows + max_data_slack && !rounded_buffer)
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
  const bool words = encoding->storage == Storage::words;
  const bool planes = encoding->storage == Storage::nv_planes || encoding->storage == Storage::planes_420;
  const auto channels_bytes = static_cast<std::uint64_t>(CV_ELEM_SIZE(encoding->opencv_type));
  Image image{*stamp, static_cast<int>(message.width), static_cast<int>(message.height), {},
              {},     notes_of(message.header)};
  const auto step = check_layout(message, channels_bytes * (words ? 2 : 1), bound, image.notes,
                                 extra_rows(encoding->storage, message.height));
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
    const std::uint32_t greatest =
        scale_to_8_bit({message.data._buffer, message.height, *step, message.is_bigendian != 0}, row_values,
                       bound.significant_bits(), grey ? image.pixels.data() : scaled.data());
    if (auto fewer = fewer_bits(greatest, bound.significant_bits()))
      add_remark(image.notes, ErrorCode::image_bits, *std::move(fewer));
    if (grey) return image;
    in = cv::Mat(image.height, image.width, encoding->opencv_type, scaled.data());
  }
  if (encoding->opencv_type == CV_8UC2)
    if (auto other = other_byte_order(message, *step, encoding->to_grey == cv::COLOR_YUV2GRAY_YUY2))
      add_remark(image.notes, ErrorCode::malformed_encoding, *std::move(other));
  if (const auto made = convert(in, encoding->to_grey, CV_8UC1, image.pixels); !made) return propagate(made);
  if (colour == Colour::none || encoding->to_rgb == no_colour) return image;
  image.rgb.resize(3 * image.pixels.size());
  if (encoding->storage == Storage::nv_444) {
    rgb_of_nv24(message.data._buffer, *step, image);
    return image;
  }
  if (planes) in = cv::Mat(image.height * 3 / 2, image.width, CV_8UC1, message.data._buffer, *step);
  if (encoding->storage == Storage::planes_420) {
    scaled = packed_planes(message.data._buffer, *step, image.width, image.height);
    in = cv::Mat(image.height * 3 / 2, image.width, CV_8UC1, scaled.data());
  }
  if (const auto made = convert(in, encoding->to_rgb, CV_8UC3, image.rgb, ImageSize{image.width, image.height}); !made)
    return propagate(made);
  return image;
}

Result<Image> decode_compressed_image(const sensor_msgs_msg_dds__CompressedImage_& message, Colour colour,
                                      const ImageBound& bound) {
  const auto stamp = decode_stamp(message.header);
  if (!stamp) return propagate(stamp);
  const std::string_view format = message.format ? message.format : "";
  if (is_depth(format) || format.find("compressedDepth") != std::string_view::npos)
    return fail(ErrorCode::malformed_depth_encoding, "format '" + escape_control(format.substr(0, 32)) +
                                                         "' is a depth image's; configure the camera's image topic");
  const std::span<const std::uint8_t> bytes(message.data._buffer, message.data._length);
  if (bytes.empty()) return fail(ErrorCode::malformed_compressed_size, "there are no bytes");
  const auto header = probe_compressed(bytes);
  if (!header && !format.empty())
    return fail(header.error().code,
                header.error().context + "; its format is '" + escape_control(format.substr(0, 32)) + "'");
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
  Image image{*stamp, width, height, {}, {}, notes_of(message.header)};
  const Encoding* const mosaic = header->channels == 1 ? mosaic_of(format) : nullptr;
  const bool grey_only = colour == Colour::none;
  const bool from_rgb = mosaic == nullptr && !grey_only;
  auto values = decode_values(bytes, *header, from_rgb ? 3 : 1, bound, image.notes);
  if (!values) return propagate(values);
  if (mosaic == nullptr && grey_only) {
    image.pixels = *std::move(values);
    return image;
  }
  const cv::Mat in(height, width, from_rgb ? CV_8UC3 : CV_8UC1, values->data());
  image.pixels.resize(static_cast<std::size_t>(width) * height);
  if (const auto made = convert(in, mosaic ? mosaic->to_grey : cv::COLOR_RGB2GRAY, CV_8UC1, image.pixels); !made)
    return propagate(made);
  if (from_rgb) image.rgb = *std::move(values);
  if (from_rgb || grey_only) return image;
  image.rgb.resize(3 * image.pixels.size());
  if (const auto made = convert(in, mosaic->to_rgb, CV_8UC3, image.rgb); !made) return propagate(made);
  return image;
}

}  // namespace calib
