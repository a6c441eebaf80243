#include <bit>
#include <cmath>
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
                               ToInverse to_inverse) {
  if (const auto sound = check_layout(message, sizeof(Pixel), bound); !sound) return propagate(sound);
  DepthImage depth{stamp, static_cast<int>(message.width), static_cast<int>(message.height), {}};
  depth.inverse_depth.reserve(std::size_t{message.width} * message.height);
  const bool swap = (message.is_bigendian != 0) != (std::endian::native == std::endian::big);
  for (std::uint32_t v = 0; v < message.height; ++v) {
    const std::uint8_t* pixel = message.data._buffer + std::size_t{v} * message.step;
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
              "encoding '" + std::string(encoding.substr(0, 32)) + "' is no depth; " + std::string(needed) + " is");
}

}  // namespace

Result<DepthImage> decode_depth(const sensor_msgs_msg_dds__Image_& message, const ImageBound& bound) {
  const auto stamp = decode_stamp(message.header);
  if (!stamp) return propagate(stamp);
  const std::string_view encoding = encoding_of(message);
  if (encoding == "16UC1")
    return read_pixels<std::uint16_t>(message, *stamp, bound, [](std::uint16_t mm, auto, auto) {
      return mm > 0 ? 1000.0F / static_cast<float>(mm) : 0;
    });
  if (encoding == "32FC1")
    return read_pixels<float>(message, *stamp, bound, [](float m, auto, auto) { return m > 0 ? 1 / m : 0; });
  return not_depth(encoding, "16UC1 (millimetres) or 32FC1 (metres)");
}

Result<DepthImage> decode_disparity(const stereo_msgs_msg_dds__DisparityImage_& message, const ImageBound& bound) {
  const auto stamp = decode_stamp(message.header);
  if (!stamp) return propagate(stamp);
  if (const auto encoding = encoding_of(message.image); encoding != "32FC1")
    return not_depth(encoding, "of disparities, 32FC1");
  const float focal_times_baseline = message.f * message.t;
  if (!(message.f > 0 && message.t > 0 && focal_times_baseline > 0 && std::isfinite(focal_times_baseline)))
    return fail(ErrorCode::malformed_disparity_scale, "f (pixels) and t (metres) must be positive");
  const float least = message.min_disparity, most = message.max_disparity;
  if (!std::isfinite(least) || !std::isfinite(most) || least > most)
    return fail(ErrorCode::malformed_disparity_range,
                "min_disparity must not exceed max_disparity, and both must be finite");
  const auto& window = message.valid_window;
  const bool whole = window.width == 0 || window.height == 0;
  const std::uint64_t right = std::uint64_t{window.x_offset} + window.width,
                      bottom = std::uint64_t{window.y_offset} + window.height;
  if (!whole && (right > message.image.width || bottom > message.image.height))
    return fail(ErrorCode::malformed_valid_window, "the valid window exceeds the image");
  const bool bounded = least < most;
  return read_pixels<float>(message.image, *stamp, bound, [&](float disparity, std::uint32_t u, std::uint32_t v) {
    const bool inside = whole || (u >= window.x_offset && v >= window.y_offset && u < right && v < bottom);
    const bool in_range = !bounded || (disparity >= least && disparity <= most);
    return inside && in_range ? disparity / focal_times_baseline : 0;
  });
}

}  // namespace calib
