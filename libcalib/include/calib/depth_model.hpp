#pragma once

#include <filesystem>
#include <limits>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "calib/result.hpp"

namespace calib {

enum class TensorLayout { nchw, nhwc };
enum class ChannelOrder { rgb, bgr, grey };
enum class Interpolation { nearest, linear, cubic, area, lanczos };

/// How an image becomes of the size that a network takes.
enum class Fit {
  stretch,             // each side to the network's own
  letterbox_centre,    // by one factor to lie within it, the rest filled on both sides
  letterbox_top_left,  // likewise, the rest filled to the right or below
  lower_bound,         // by one factor so that it covers the nominal size; the network takes what comes out
  upper_bound,         // by one factor so that it lies within the nominal size; likewise
};

/// What the network's output is a measure of.
enum class DepthSemantics {
  inverse_relative,   // inverse depth of unknown scale, larger is nearer
  disparity,          // in pixels or of the width; likewise
  disparity_sigmoid,  // d, where depth is 1 / (a d + b)
  depth_relative,     // depth of unknown scale
  depth_metric,       // metres
};

/// A colour, as the bytes of the image are, becomes (colour * scale - mean) / std.
struct NetworkInput {
  std::string name;
  TensorLayout layout = TensorLayout::nchw;
  ChannelOrder channel_order = ChannelOrder::rgb;
  int width = 0, height = 0;  // nominal ones with Fit::lower_bound and upper_bound
  Fit fit = Fit::stretch;
  int multiple_of = 1;  // both sides, with Fit::lower_bound and upper_bound
  Interpolation interpolation = Interpolation::area;
  double scale = 1;
  std::vector<double> mean, std;            // of each channel, in `channel_order`
  std::optional<std::vector<double>> fill;  // of a letterbox: a colour; default: what becomes 0

  [[nodiscard]] int channels() const { return channel_order == ChannelOrder::grey ? 1 : 3; }
};

struct NetworkOutput {
  std::string name;
  DepthSemantics semantics = DepthSemantics::inverse_relative;
  double a = 1, b = 0;     // of disparity_sigmoid
  bool along_ray = false;  // not along the optical axis
  /// depth_metric is as a camera with this focal length would see it (Metric3D): for another, with f pixels at the size
  /// that the image has in the network's input, the depth is f / canonical_focal_px times that.
  std::optional<double> canonical_focal_px;
  /// Of the output as it comes; in metres, after scaling by the focal length, for depth_metric. What is outside is no
  /// depth.
  double min = -std::numeric_limits<double>::infinity(), max = std::numeric_limits<double>::infinity();
};

/// What the network must make of a picture: proof that network, preprocessing and processor are as they were meant.
struct GoldenPair {
  std::filesystem::path image;
  /// The output tensor as the network gives it: 32-bit little-endian floats, no header.
  std::filesystem::path output;
  double tolerance = 0.01;  // greatest difference, as a share of the golden output's own range
};

/// A depth network as its YAML descriptor describes it; calibd-model(5) explains each key.
struct DepthModel {
  std::filesystem::path descriptor;
  std::filesystem::path file;
  std::string sha256;  // lower-case hex
  NetworkInput input;
  NetworkOutput output;
  std::optional<GoldenPair> golden;
};

/// `yaml` as the text of `descriptor`, in whose folder the other files are. Fails with `bad_config` and one line
/// `FILE:LINE: key: what is wrong; what to write`.
[[nodiscard]] Result<DepthModel> parse_depth_model(std::string_view yaml, const std::filesystem::path& descriptor);

/// `parse_depth_model` of a file. Fails also with `config_not_found`.
[[nodiscard]] Result<DepthModel> load_depth_model(const std::filesystem::path& descriptor);

}  // namespace calib
