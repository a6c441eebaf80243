#include <algorithm>
#include <cmath>
#include <span>
#include <sstream>
#include <string_view>

#include "dds/decode.hpp"

namespace calib {
namespace {

std::string_view text(const char* string) { return string ? std::string_view(string) : std::string_view(); }

bool all_finite(std::span<const double> values) {
  return std::ranges::all_of(values, [](double value) { return std::isfinite(value); });
}

struct Lens {
  CameraModel model;
  std::vector<double> distortion;
};

/// The camera model that CameraInfo calls `name`; nothing for a name that no model has.
const CameraModelFacts* model_of(std::string_view name) {
  const auto found = std::ranges::find_if(all_camera_models, [&](const CameraModelFacts& model) {
    return model.ros && (name == model.ros->name || name == model.ros->other_name);
  });
  return found == all_camera_models.end() ? nullptr : &*found;
}

/// What CameraInfo may call a lens, "none" last.
std::string model_names() {
  std::string names;
  for (const CameraModelFacts& model : all_camera_models) {
    if (!model.ros || model.parameters.empty()) continue;
    names += std::string(model.ros->name) + ", ";
    if (model.ros->other_name != model.ros->name) names += std::string(model.ros->other_name) + ", ";
  }
  return names + "none";
}

/// The coefficients of a distortion model as `Camera` takes them.
Result<Lens> lens(std::string_view name, std::span<const double> d) {
  const std::string shown = "distortion model '" + escape_control(name.substr(0, 32)) + "' ";
  const std::string counted = shown + "with " + std::to_string(d.size()) + " coefficients in D: ";
  if (!all_finite(d)) return fail(ErrorCode::malformed_distortion, counted + "one is not finite");
  const CameraModelFacts* const model = model_of(name);
  if (model == nullptr) return fail(ErrorCode::malformed_distortion, shown + "is none of " + model_names());
  // Some drivers send as many as their largest model has. The larger models of OpenCV add thin prism and tilt, which no
  // model here has.
  const std::size_t own = model->parameters.size();
  const bool others_are_zero =
      std::ranges::all_of(d.subspan(std::min(own, d.size())), [](double value) { return value == 0; });
  const bool is_rational = model->model == CameraModel::plumb_bob && d.size() >= 8;
  if (!others_are_zero)
    return fail(ErrorCode::malformed_distortion, counted + std::string(model->ros->needed) +
                                                     ", and those behind them are not 0" +
                                                     (is_rational ? ": this is rational_polynomial" : ""));
  d = d.first(std::min(own, d.size()));
  if (!model->ros->takes(d.size()))
    return fail(ErrorCode::malformed_distortion, counted + std::string(model->ros->needed));
  Lens lens{model->model, {d.begin(), d.end()}};
  lens.distortion.resize(own, 0.0);
  return lens;
}

/// The part of the sensor that an image shows, along one side.
struct Extent {
  std::uint64_t offset, pixels, binning;

  [[nodiscard]] int image_pixels() const { return static_cast<int>(pixels / binning); }
  /// Changes nothing of a matrix that is zero, which means that there is none.
  void adjust(double& focal, double& centre) const {
    if (focal == 0) return;
    focal /= static_cast<double>(binning);
    centre = (centre - static_cast<double>(offset) + 0.5) / static_cast<double>(binning) - 0.5;
  }
};

/// A roi of 0 pixels extends from its offset to the end; a binning of 0 means 1.
Result<Extent> extent(std::uint32_t full, std::uint32_t offset, std::uint32_t roi, std::uint32_t binning) {
  if (offset >= full || roi > full - offset)
    return fail(ErrorCode::malformed_roi, "the roi begins at " + std::to_string(offset) + " and has " +
                                              std::to_string(roi) + " of the " + std::to_string(full) +
                                              " pixels of the full image");
  const Extent extent{offset, roi == 0 ? full - offset : roi, std::max(binning, 1U)};
  if (extent.binning > extent.pixels)
    return fail(ErrorCode::malformed_roi, "a binning of " + std::to_string(binning) + " leaves no pixel of the " +
                                              std::to_string(extent.pixels) + " of the roi");
  return extent;
}

std::string number(double value) {
  std::ostringstream text;
  text << value;
  return text.str();
}

std::string by(std::uint32_t across, std::uint32_t down) {
  return std::to_string(across) + " x " + std::to_string(down);
}

/// Binning and roi in words, where they change the size of the image.
std::string reduction_words(const sensor_msgs_msg_dds__CameraInfo_& message) {
  std::string words;
  if (message.binning_x > 1 || message.binning_y > 1)
    words += " with binning " + by(std::max(message.binning_x, 1U), std::max(message.binning_y, 1U));
  const auto& roi = message.roi;
  if (roi.x_offset > 0 || roi.y_offset > 0 || (roi.width > 0 && roi.width != message.width) ||
      (roi.height > 0 && roi.height != message.height))
    words += (words.empty() ? " with a roi of " : " and a roi of ") + by(roi.width, roi.height) + " at " +
             std::to_string(roi.x_offset) + ", " + std::to_string(roi.y_offset);
  return words.empty() ? words : by(message.width, message.height) + words;
}

}  // namespace

Result<CameraInfo> decode_camera_info(const sensor_msgs_msg_dds__CameraInfo_& message, InfoReduction reduction) {
  const auto stamp = decode_stamp(message.header);
  if (!stamp) return propagate(stamp);
  const bool has_k = message.k[0] != 0 || message.k[4] != 0, has_p = message.p[0] != 0 || message.p[5] != 0;
  if (!has_k && !has_p)
    return fail(ErrorCode::malformed_uncalibrated,
                "the driver says that this camera is not calibrated: the focal lengths in K and P are 0");
  const std::uint64_t pixels = std::uint64_t{message.width} * message.height;
  if (pixels < 1 || pixels > max_image_pixels)
    return fail(
        ErrorCode::malformed_image_size,
        std::to_string(message.width) + " x " + std::to_string(message.height) + " pixels are outside 1 .. 64 Mpx");
  const bool whole = reduction == InfoReduction::ignored;
  const auto& roi = message.roi;
  const auto across =
      whole ? extent(message.width, 0, 0, 0) : extent(message.width, roi.x_offset, roi.width, message.binning_x);
  if (!across) return propagate(across);
  const auto down =
      whole ? extent(message.height, 0, 0, 0) : extent(message.height, roi.y_offset, roi.height, message.binning_y);
  if (!down) return propagate(down);
  const auto distortion =
      lens(text(message.distortion_model), std::span<const double>(message.d._buffer, message.d._length));
  if (!distortion) return propagate(distortion);

  CameraInfo info{.stamp = *stamp,
                  .width = across->image_pixels(),
                  .height = down->image_pixels(),
                  .model = distortion->model,
                  .K = {},
                  .D = distortion->distortion,
                  .P = {},
                  .R = {},
                  .reduced_from = whole ? "" : reduction_words(message),
                  .notes = notes_of(message.header)};
  std::ranges::copy(message.r, info.R.begin());
  std::ranges::copy(message.k, info.K.begin());
  std::ranges::copy(message.p, info.P.begin());
  if (reduction == InfoReduction::as_specified) {
    across->adjust(info.K[0], info.K[2]);
    down->adjust(info.K[4], info.K[5]);
    across->adjust(info.P[0], info.P[2]);
    down->adjust(info.P[5], info.P[6]);
    info.P[3] /= static_cast<double>(across->binning);  // -fx times the baseline
    info.P[7] /= static_cast<double>(down->binning);
  }
  const auto& of = has_k ? info.K : std::array<double, 9>{info.P[0], 0, 0, 0, info.P[5]};
  const auto in_range = [](double f) { return f > 1 && f < 1e5; };
  if (!all_finite(info.K) || !all_finite(info.P))
    return fail(ErrorCode::malformed_intrinsics, "a number in K or P is not finite");
  if (!in_range(of[0]) || !in_range(of[4]))
    return fail(ErrorCode::malformed_intrinsics, std::string("the focal lengths in ") + (has_k ? "K" : "P") + " are " +
                                                     number(of[0]) + " and " + number(of[4]) +
                                                     " pixels (after binning), where 1 .. 1e5 are allowed");
  return info;
}

}  // namespace calib
