#include "network_check.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>

#include "calib/quality.hpp"
#include "network_image.hpp"

namespace calib::ctl {
namespace {

bool is_depth(DepthSemantics semantics) {
  return semantics == DepthSemantics::depth_relative || semantics == DepthSemantics::depth_metric;
}

/// `values` in any order, not empty.
float quantile(std::vector<float>& values, double share) {
  const auto at = values.begin() + static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size() - 1));
  std::ranges::nth_element(values, at);
  return *at;
}

std::vector<float> inverse_depths(const DepthMap& depth, int first_row, int end_row) {
  std::vector<float> found;
  for (auto i = static_cast<std::size_t>(first_row) * depth.width; i < static_cast<std::size_t>(end_row) * depth.width;
       ++i)
    if (depth.inverse_depth[i] > DepthMap::no_depth) found.push_back(depth.inverse_depth[i]);
  return found;
}

/// The rows above which half of the pixels with depth lie. They, not the rows of the image, are halved: what has no
/// depth is mostly the sky.
int middle_row(const DepthMap& depth, std::size_t valid) {
  std::size_t above = 0;
  for (int row = 0; row < depth.height; ++row) {
    above += inverse_depths(depth, row, row + 1).size();
    if (2 * above >= valid) return row + 1;
  }
  return depth.height;
}

void describe_depth(const DepthMap& depth, NetworkReport& report) {
  report.valid_share = depth.valid_share();
  auto inverse = inverse_depths(depth, 0, depth.height);
  if (inverse.empty()) return;
  report.depth.emplace();
  for (std::size_t i = 0; i < NetworkReport::quantiles.size(); ++i)
    (*report.depth)[i] = 1.0 / quantile(inverse, 1 - NetworkReport::quantiles[i]);
  const int middle = middle_row(depth, inverse.size());
  auto upper = inverse_depths(depth, 0, middle), lower = inverse_depths(depth, middle, depth.height);
  if (!upper.empty() && !lower.empty()) report.lower_over_upper = quantile(lower, 0.5) / quantile(upper, 0.5);
}

std::string exchanged_remedy(DepthSemantics semantics) {
  const std::string now(semantics_name(semantics));
  return is_depth(semantics)
             ? "if the network gives inverse depth or disparity, write output.semantics: inverse_relative (or "
               "disparity) "
               "instead of " +
                   now
             : "if the network gives depth, write output.semantics: depth_relative (or depth_metric) instead of " + now;
}

void suspect_depth(const DepthMap& depth, const NetworkFrame& frame, NetworkReport& report) {
  const NetworkOutput& output = report.model.output;
  auto& found = report.suspicions;
  if (const auto enough = check_depth(depth, {}); !enough)
    found.push_back({"few_valid_depth", enough.error().context + "; calibd would not evaluate this frame",
                     "widen output.valid_range, or use a frame that shows more than sky"});
  if (!report.depth) return;
  const auto& quantiles = *report.depth;
  if (quantiles.back() <= quantiles.front() * 1.001) {
    found.push_back({"flat", "all pixels have the same depth: the network ignores the image",
                     "compare input.scale, mean, std and channel_order with the network's own preprocessing"});
    return;
  }
  const bool by_scan = report.agreement.has_value();
  if (by_scan && report.agreement->rank_correlation < 0)
    found.push_back({"depth_inverted",
                     fmt::format("near and far are exchanged: the rank correlation with the LiDAR is {:.2f}",
                                 report.agreement->rank_correlation),
                     exchanged_remedy(output.semantics)});
  else if (!by_scan && frame.shows_a_road && report.lower_over_upper && *report.lower_over_upper < 1)
    found.push_back({"depth_inverted",
                     fmt::format("near and far seem to be exchanged: below, where a road is near, the median depth is "
                                 "{:.1f} times that above",
                                 1 / *report.lower_over_upper),
                     exchanged_remedy(output.semantics)});
  else if (by_scan && report.agreement->rank_correlation < 0.5)
    found.push_back(
        {"low_agreement",
         fmt::format("depth hardly grows with the LiDAR's range: rank correlation {:.2f}, and good depth has "
                     "0.8 and more",
                     report.agreement->rank_correlation),
         "check that image, cloud and extrinsic belong together, then input.scale, mean, std and "
         "channel_order"});
  if (output.semantics != DepthSemantics::depth_metric || !frame.camera_is_known) return;
  constexpr double tolerated = 1.25;
  if (by_scan && report.agreement->rank_correlation >= 0.5 &&
      (report.agreement->scale > tolerated || report.agreement->scale < 1 / tolerated))
    found.push_back(
        {"not_metric",
         fmt::format("metres do not fit: the LiDAR's depth is {:.2f} times the network's", report.agreement->scale),
         output.canonical_focal_px
             ? "check output.canonical_focal_px, or write semantics: depth_relative"
             : "set output.canonical_focal_px if the network assumes a focal length, or write semantics: "
               "depth_relative"});
  else if (!by_scan && (quantiles[3] < 0.5 || quantiles[3] > 500))
    found.push_back({"not_metric", fmt::format("the median depth is {:.3g} m, which no street has", quantiles[3]),
                     "check the unit of the output, or write output.semantics: depth_relative"});
}

}  // namespace

std::string_view semantics_name(DepthSemantics semantics) {
  switch (semantics) {
    case DepthSemantics::inverse_relative:
      return "inverse_relative";
    case DepthSemantics::disparity:
      return "disparity";
    case DepthSemantics::disparity_sigmoid:
      return "disparity_sigmoid";
    case DepthSemantics::depth_relative:
      return "depth_relative";
    case DepthSemantics::depth_metric:
      break;
  }
  return "depth_metric";
}

std::vector<Suspicion> suspicions_of(const NetworkInput& input) {
  for (std::size_t channel = 0; channel < input.mean.size(); ++channel) {
    if (input.mean[channel] == 0 && input.std[channel] == 1) continue;  // normalised by the network, or not at all
    const double black = (0 - input.mean[channel]) / input.std[channel],
                 white = (255 * input.scale - input.mean[channel]) / input.std[channel];
    // Of every published normalisation: from -3 .. 0 to 1 .. 3.
    if (black >= -10 && white <= 10 && white - black >= 0.5) continue;
    return {
        {"normalisation",
         fmt::format("a byte of 0 .. 255 becomes {:.3g} .. {:.3g}; networks expect about -2 .. 2", black, white),
         "mean and std are for bytes times input.scale: with mean 0.485, 0.456, 0.406 write scale: 1/255, with mean "
         "123.675, 116.28, 103.53 write scale: 1"}};
  }
  return {};
}

Result<NetworkReport> check_network(const DepthModel& model, const NetworkFrame& frame, int runs,
                                    const OnnxSettings& settings) {
  NetworkReport report;
  report.model = model;
  const auto estimator = make_onnx_depth(model.descriptor, frame.camera, settings);
  if (!estimator) return propagate(estimator);
  const auto remark = (*estimator)->prepare();
  if (!remark) return propagate(remark);
  report.remark = *remark;
  const Placement placement = place(model.input, frame.pair.image.width, frame.pair.image.height);
  report.input_width = placement.width;
  report.input_height = placement.height;

  std::vector<float> times_ms;
  Result<DepthMap> depth = fail(ErrorCode::no_depth, "");
  for (int run = 0; run < runs; ++run) {
    const auto begin = std::chrono::steady_clock::now();
    depth = (*estimator)->estimate(frame.pair);
    if (!depth) return propagate(depth);
    times_ms.push_back(std::chrono::duration<float, std::milli>(std::chrono::steady_clock::now() - begin).count());
  }
  report.run_ms = quantile(times_ms, 0.5);
  describe_depth(*depth, report);
  if (frame.T_camera_lidar)
    report.agreement = depth_agreement(*depth, frame.camera, *frame.T_camera_lidar, frame.pair.scan);
  report.suspicions = suspicions_of(model.input);
  suspect_depth(*depth, frame, report);
  return report;
}

}  // namespace calib::ctl
