#include <bit>
#include <cmath>
#include <sstream>
#include <string_view>

#include "dds/decode.hpp"

namespace calib {
namespace {

/// A pixel at any address, in either byte order.
template <typename T>
T read_as(const std::uint8_t* bytes, bool swap) {
  std::array<std::uint8_t, sizeof(T)> raw;
  for (std::size_t i = 0; i < sizeof(T); ++i) raw[i] = bytes[swap ? sizeof(T) - 1 - i : i];
  return std::bit_cast<T>(raw);
}

/// `to_inverse` is called for each pixel with its value, column and row.
template <typename Pixel, typename ToInverse>
Result<DepthImage> read_pixels(const sensor_msgs_msg_dds__Image_& message, Timestamp stamp, const ImageBound& bound,
                               MessageNotes notes, ToInverse to_inverse) {
  const auto step = check_layout(message, sizeof(Pixel), bound, notes);
  if (!step) return propagate(step);
  DepthImage depth{stamp, static_cast<int>(message.width), static_cast<int>(message.height), {}, std::move(notes)};
  depth.inverse_depth.reserve(std::size_t{message.width} * message.height);
  const bool swap = (message.is_bigendian != 0) != (std::endian::native == std::endian::big);
  for (std::uint32_t v = 0; v < message.height; ++v) {
    const std::uint8_t* pixel = message.data._buffer + std::size_t{v} * *step;
    for (std::uint32_t u = 0; u < message.width; ++u, pixel += sizeof(Pixel)) {
      const float inverse = to_inverse(read_as<Pixel>(pixel, swap), u, v);
      depth.inverse_depth.push_back(inverse > 0 && std::isfinite(inverse) ? inverse : 0);
    }
  }
  return depth;
}

std::string_view encoding_of(const sensor_msgs_msg_dds__Image_& message) {
  return message.encoding != nullptr ? message.encoding : "";
}

tl::unexpected<Error> not_depth(std::string_view encoding, std::string_view needed) {
  return fail(ErrorCode::malformed_encoding,
              "encoding '" + escape_control(encoding.substr(0, 32)) + "' is no depth; " + std::string(needed) + " is");
}

std::string number(double value) {
  std::ostringstream text;
  text << value;
  return text.str();
}

struct Range {
  float least = 0, most = 0;  // no limit where they are equal

  [[nodiscard]] bool has(float disparity) const { return !(least < most) || (disparity >= least && disparity <= most); }
};

/// Advisory: one that makes no sense limits nothing.
Range disparity_range(const stereo_msgs_msg_dds__DisparityImage_& message, MessageNotes& notes) {
  const float least = message.min_disparity, most = message.max_disparity;
  if (std::isfinite(least) && std::isfinite(most) && least <= most) return {least, most};
  add_remark(notes, ErrorCode::malformed_disparity_range,
             "min_disparity is " + number(least) + " and max_disparity " + number(most) +
                 ", where the first must not exceed the second, and both must be finite; they are ignored");
  return {};
}

struct Window {
  std::uint64_t left = 0, top = 0, right = 0, bottom = 0;

  [[nodiscard]] bool has(std::uint32_t u, std::uint32_t v) const {
    return u >= left && u < right && v >= top && v < bottom;
  }
};

/// Advisory: a window of 0 pixels is the whole image, and so is one that exceeds it. The node of image_pipeline makes
/// one that wraps around below 0 before its image has a size.
Window valid_window(const stereo_msgs_msg_dds__DisparityImage_& message, MessageNotes& notes) {
  const auto& window = message.valid_window;
  const Window whole{0, 0, message.image.width, message.image.height};
  if (window.width == 0 || window.height == 0) return whole;
  const Window given{window.x_offset, window.y_offset, std::uint64_t{window.x_offset} + window.width,
                     std::uint64_t{window.y_offset} + window.height};
  if (given.right <= whole.right && given.bottom <= whole.bottom) return given;
  const auto words = [](std::uint64_t x, std::uint64_t y) { return std::to_string(x) + ", " + std::to_string(y); };
  add_remark(notes, ErrorCode::malformed_valid_window,
             "valid_window begins at " + words(given.left, given.top) + " and ends at " +
                 words(given.right, given.bottom) + ", and the image at " + words(whole.right, whole.bottom) +
                 "; it is ignored");
  return whole;
}

}  // namespace

Result<DepthImage> decode_depth(const sensor_msgs_msg_dds__Image_& message, const ImageBound& bound) {
  const auto stamp = decode_stamp(message.header);
  if (!stamp) return propagate(stamp);
  const std::string_view encoding = encoding_of(message);
  if (encoding == "16UC1" || encoding == "mono16") {
    MessageNotes notes = notes_of(message.header);
    if (encoding == "mono16")
      add_remark(notes, ErrorCode::malformed_encoding,
                 "encoding 'mono16' is read as 16UC1, depth in millimetres, since this is a topic of depth");
    return read_pixels<std::uint16_t>(message, *stamp, bound, std::move(notes), [](std::uint16_t mm, auto, auto) {
      return mm > 0 ? 1000.0F / static_cast<float>(mm) : 0;
    });
  }
  if (encoding == "32FC1")
    return read_pixels<float>(message, *stamp, bound, notes_of(message.header),
                              [](float m, auto, auto) { return m > 0 ? 1 / m : 0; });
  return not_depth(encoding, "16UC1 (millimetres) or 32FC1 (metres)");
}

Result<DepthImage> decode_disparity(const stereo_msgs_msg_dds__DisparityImage_& message, const ImageBound& bound) {
  const auto stamp = decode_stamp(message.header);
  if (!stamp) return propagate(stamp);
  if (const auto encoding = encoding_of(message.image); encoding != "32FC1")
    return not_depth(encoding, "of disparities, 32FC1");
  const float focal_times_baseline = message.f * message.t;
  if (!(message.f > 0 && message.t > 0 && focal_times_baseline > 0 && std::isfinite(focal_times_baseline)))
    return fail(ErrorCode::malformed_disparity_scale, "f is " + number(message.f) + " pixels and t is " +
                                                          number(message.t) + " m, where both must be positive");
  MessageNotes notes = notes_of(message.header);
  const Range range = disparity_range(message, notes);
  const Window window = valid_window(message, notes);
  std::uint64_t positive = 0, negative = 0;
  auto depth = read_pixels<float>(
      message.image, *stamp, bound, std::move(notes), [&](float disparity, std::uint32_t u, std::uint32_t v) {
        positive += disparity > 0 && std::isfinite(disparity);
        negative += disparity < -1 && std::isfinite(disparity);  // -1: none was found
        return window.has(u, v) && range.has(disparity) ? disparity / focal_times_baseline : 0.0F;
      });
  if (depth && negative > positive)
    add_remark(depth->notes, ErrorCode::malformed_disparity_sign,
               std::to_string(negative) + " disparities are negative and " + std::to_string(positive) +
                   " positive; depth needs positive ones, the column in the left image minus that in the right one");
  return depth;
}

}  // namespace calib
