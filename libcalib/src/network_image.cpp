#include "network_image.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <opencv2/imgproc.hpp>

namespace calib {
namespace {

/// As MiDaS, DPT and Depth Anything round: to the nearest multiple, but never beyond `bound`.
int rounded(double length, int multiple, int bound, Fit fit) {
  const double count = length / multiple;
  int rounded = static_cast<int>(std::nearbyint(count)) * multiple;
  if (fit == Fit::lower_bound && rounded < bound) rounded = static_cast<int>(std::ceil(count)) * multiple;
  if (fit == Fit::upper_bound && rounded > bound) rounded = static_cast<int>(std::floor(count)) * multiple;
  return std::max(rounded, multiple);
}

int opencv_interpolation(Interpolation interpolation) {
  switch (interpolation) {
    case Interpolation::nearest:
      return cv::INTER_NEAREST;
    case Interpolation::linear:
      return cv::INTER_LINEAR;
    case Interpolation::cubic:
      return cv::INTER_CUBIC;
    case Interpolation::area:
      return cv::INTER_AREA;
    case Interpolation::lanczos:
      return cv::INTER_LANCZOS4;
  }
  std::abort();
}

/// What each byte of each channel becomes.
using ByteValues = std::array<float, 256>;
std::vector<ByteValues> byte_values(const NetworkInput& input) {
  std::vector<ByteValues> values(input.channels());
  for (int channel = 0; channel < input.channels(); ++channel)
    for (int byte = 0; byte < 256; ++byte)
      values[channel][byte] = static_cast<float>((byte * input.scale - input.mean[channel]) / input.std[channel]);
  return values;
}

/// The pixels of the network's map between whose centres those of one row or column of the image lie.
struct Taps {
  std::vector<int> first;
  std::vector<float> weight_of_next;
};

/// Along one side: `image` pixels lie in `extent` of the `input` pixels from `start` on; the map has `map` for them.
Taps taps(int image, int start, int extent, int input, int map) {
  const double scale = static_cast<double>(map) / input;
  // Those that see only the image, not what a letterbox is filled with.
  const int last = std::clamp(static_cast<int>(std::floor((start + extent) * scale - 0.5)), 0, map - 1);
  const int first = std::clamp(static_cast<int>(std::ceil(start * scale - 0.5)), 0, last);
  Taps taps;
  for (int i = 0; i < image; ++i) {
    const double centre = (start + (i + 0.5) * extent / image) * scale - 0.5;
    const double within = std::clamp(centre, static_cast<double>(first), static_cast<double>(last));
    const int tap = std::min(static_cast<int>(within), std::max(0, last - 1));
    taps.first.push_back(tap);
    taps.weight_of_next.push_back(static_cast<float>(within - tap));
  }
  return taps;
}

float inverse_depth(const NetworkOutput& output, float metres_per_unit, float value) {
  if (output.semantics == DepthSemantics::depth_metric) value *= metres_per_unit;
  if (!(value >= output.min && value <= output.max)) return DepthMap::no_depth;
  float inverse = value;
  if (output.semantics == DepthSemantics::disparity_sigmoid)
    inverse = static_cast<float>(output.a * value + output.b);
  else if (output.semantics == DepthSemantics::depth_relative || output.semantics == DepthSemantics::depth_metric)
    inverse = 1 / value;
  return inverse > 0 && std::isfinite(inverse) ? inverse : DepthMap::no_depth;
}

}  // namespace

Placement place(const NetworkInput& input, int image_width, int image_height) {
  const double across = static_cast<double>(input.width) / image_width,
               down = static_cast<double>(input.height) / image_height;
  if (input.fit == Fit::stretch) return {input.width, input.height, 0, 0, input.width, input.height};
  const double factor = input.fit == Fit::lower_bound ? std::max(across, down) : std::min(across, down);
  if (input.fit == Fit::lower_bound || input.fit == Fit::upper_bound) {
    const int width = rounded(image_width * factor, input.multiple_of, input.width, input.fit),
              height = rounded(image_height * factor, input.multiple_of, input.height, input.fit);
    return {width, height, 0, 0, width, height};
  }
  const int width = std::clamp(static_cast<int>(std::lround(image_width * factor)), 1, input.width),
            height = std::clamp(static_cast<int>(std::lround(image_height * factor)), 1, input.height);
  const bool centre = input.fit == Fit::letterbox_centre;
  return {input.width, input.height, centre ? (input.width - width) / 2 : 0, centre ? (input.height - height) / 2 : 0,
          width,       height};
}

std::vector<float> to_tensor(const NetworkInput& input, const Placement& placement, const Image& image) {
  const bool colour = input.channel_order != ChannelOrder::grey && !image.rgb.empty();
  const auto& source = colour ? image.rgb : image.pixels;
  const cv::Mat whole(image.height, image.width, colour ? CV_8UC3 : CV_8UC1,
                      const_cast<std::uint8_t*>(source.data()));  // read only
  cv::Mat fitted;
  cv::resize(whole, fitted, {placement.image_width, placement.image_height}, 0, 0,
             opencv_interpolation(input.interpolation));

  const int channels = input.channels();
  const std::size_t pixels = static_cast<std::size_t>(placement.width) * placement.height;
  const bool planar = input.layout == TensorLayout::nchw;
  const std::size_t pixel_stride = planar ? 1 : channels, channel_stride = planar ? pixels : 1;
  std::vector<float> tensor(pixels * channels, 0.0F);
  const auto values = byte_values(input);
  for (int channel = 0; channel < channels; ++channel) {
    float* const plane = tensor.data() + channel * channel_stride;
    if (input.fill) {
      const auto fill =
          static_cast<float>(((*input.fill)[channel] * input.scale - input.mean[channel]) / input.std[channel]);
      for (std::size_t i = 0; i < pixels; ++i) plane[i * pixel_stride] = fill;
    }
    const int of_source = !colour ? 0 : input.channel_order == ChannelOrder::bgr ? 2 - channel : channel;
    for (int v = 0; v < placement.image_height; ++v) {
      const auto* row = fitted.ptr<std::uint8_t>(v) + of_source;
      float* out = plane + (static_cast<std::size_t>(placement.y + v) * placement.width + placement.x) * pixel_stride;
      for (int u = 0; u < placement.image_width; ++u)
        out[u * pixel_stride] = values[channel][row[u * fitted.channels()]];
    }
  }
  return tensor;
}

DepthMap to_depth(const NetworkOutput& output, const Placement& placement, const NetworkMap& map,
                  const Camera& camera) {
  float metres_per_unit = 1;
  if (output.canonical_focal_px)
    metres_per_unit =
        static_cast<float>(camera.fx() * placement.image_width / camera.width() / *output.canonical_focal_px);
  std::vector<float> inverse(map.values.size());
  std::ranges::transform(map.values, inverse.begin(),
                         [&](float value) { return inverse_depth(output, metres_per_unit, value); });

  DepthMap depth{camera.width(), camera.height(), {}, output.along_ray};
  depth.inverse_depth.reserve(static_cast<std::size_t>(depth.width) * depth.height);
  const Taps columns = taps(depth.width, placement.x, placement.image_width, placement.width, map.width);
  const Taps rows = taps(depth.height, placement.y, placement.image_height, placement.height, map.height);
  const int right = map.width > 1 ? 1 : 0, below = map.height > 1 ? map.width : 0;
  for (int v = 0; v < depth.height; ++v)
    for (int u = 0; u < depth.width; ++u) {
      const float across = columns.weight_of_next[u], down = rows.weight_of_next[v];
      const float* const at = inverse.data() + static_cast<std::size_t>(rows.first[v]) * map.width + columns.first[u];
      const float corners[] = {at[0], at[right], at[below], at[below + right]};
      const bool all_valid = std::ranges::all_of(corners, [](float corner) { return corner > DepthMap::no_depth; });
      const float upper = corners[0] + (corners[1] - corners[0]) * across,
                  lower = corners[2] + (corners[3] - corners[2]) * across;
      depth.inverse_depth.push_back(all_valid ? upper + (lower - upper) * down
                                              : corners[(down >= 0.5F ? 2 : 0) + (across >= 0.5F ? 1 : 0)]);
    }
  return depth;
}

}  // namespace calib
