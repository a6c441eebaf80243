#include "network_report.hpp"

#include <fmt/format.h>

#include <nlohmann/json.hpp>

#include "text.hpp"

namespace calib::ctl {
namespace {

using nlohmann::json;

std::string_view fit_words(Fit fit) {
  switch (fit) {
    case Fit::stretch:
      return "the image stretched to it";
    case Fit::letterbox_centre:
    case Fit::letterbox_top_left:
      return "the image scaled to lie within it, the rest filled";
    case Fit::lower_bound:
      return "the image scaled to cover the nominal size";
    case Fit::upper_bound:
      break;
  }
  return "the image scaled to lie within the nominal size";
}

std::string_view channel_words(ChannelOrder order) {
  return order == ChannelOrder::grey ? "grey" : order == ChannelOrder::rgb ? "RGB" : "BGR";
}

std::string_view semantics_words(DepthSemantics semantics) {
  switch (semantics) {
    case DepthSemantics::inverse_relative:
      return "inverse depth without a scale, larger is nearer";
    case DepthSemantics::disparity:
      return "disparity, larger is nearer";
    case DepthSemantics::disparity_sigmoid:
      return "disparity, depth = 1 / (a v + b)";
    case DepthSemantics::depth_relative:
      return "depth without a scale, larger is farther";
    case DepthSemantics::depth_metric:
      break;
  }
  return "depth in metres";
}

bool in_metres(const NetworkReport& report, const NetworkFrame& frame) {
  return report.model.output.semantics == DepthSemantics::depth_metric &&
         (frame.camera_is_known || !report.model.output.canonical_focal_px);
}

std::string input_line(const NetworkReport& report, const NetworkFrame& frame) {
  const NetworkInput& input = report.model.input;
  std::string text = fmt::format("{}: {}, {} x {}, {}", input.name, channel_words(input.channel_order),
                                 report.input_width, report.input_height, fit_words(input.fit));
  if (input.channel_order != ChannelOrder::grey && frame.pair.image.rgb.empty()) text += " (this image is grey)";
  return text;
}

std::string depth_line(const NetworkReport& report, const NetworkFrame& frame) {
  if (!report.depth) return "none: no pixel has a valid value";
  std::string text;
  for (std::size_t i = 0; i < NetworkReport::quantiles.size(); ++i)
    text += fmt::format("{}{:.3g}", i == 0 ? "" : ", ", (*report.depth)[i]);
  return text + (in_metres(report, frame) ? " m" : " (no unit)");
}

std::string quantile_words() {
  std::string text;
  for (const double share : NetworkReport::quantiles)
    text += fmt::format("{}{:g}", text.empty() ? "" : ", ", 100 * share);
  return text + " % of the pixels are nearer than";
}

std::string order_line(const NetworkReport& report) {
  if (!report.lower_over_upper) return "not known";
  const double ratio = *report.lower_over_upper;
  return ratio >= 1 ? fmt::format("near below, far above ({:.1f} times as far)", ratio)
                    : fmt::format("far below, near above ({:.1f} times as far)", 1 / ratio);
}

std::string agreement_line(const NetworkReport& report, const NetworkFrame& frame) {
  if (!frame.T_camera_lidar) return "not measured: there is no cloud";
  if (!report.agreement)
    return fmt::format("not measured: fewer than {} points are on a pixel with depth", min_agreeing_points);
  std::string text = fmt::format("rank correlation (Spearman) {:.3f} over {} points",
                                 report.agreement->rank_correlation, report.agreement->points);
  if (in_metres(report, frame)) text += fmt::format("; LiDAR / network {:.2f}", report.agreement->scale);
  return text;
}

}  // namespace

std::string report_text(const NetworkReport& report, const NetworkFrame& frame) {
  Text text(/*coloured=*/false);
  text.line("Network", report.model.file.string());
  text.line("File", "its SHA-256 is that of the descriptor");
  text.wrapped("Input", input_line(report, frame));
  text.wrapped("Output", report.model.output.name + ": " + std::string(semantics_name(report.model.output.semantics)) +
                             ", " + std::string(semantics_words(report.model.output.semantics)));
  text.line("Self-test", report.model.golden ? fmt::format("passed: the golden output, within {:g} of its range",
                                                           report.model.golden->tolerance)
                                             : std::string("only that it runs: the descriptor names no golden pair"));
  if (!report.remark.empty()) text.wrapped("Remark", report.remark);
  text.blank();
  text.line("Frame", frame.name);
  text.line("Time", fmt::format("{:.1f} ms a frame", report.run_ms));
  text.line("Pixels", fmt::format("{:.1f} % have depth", 100 * report.valid_share));
  text.line("Depth", depth_line(report, frame));
  text.line("", quantile_words());
  text.line("Order", order_line(report));
  text.line("LiDAR", agreement_line(report, frame));
  text.blank();
  for (const Suspicion& suspicion : report.suspicions) {
    text.wrapped("SUSPICION", suspicion.seen);
    text.wrapped("  remedy", suspicion.remedy);
  }
  if (report.suspicions.empty()) text.line("Suspicions", "none");
  return text.str();
}

json report_json(const NetworkReport& report, const NetworkFrame& frame) {
  const NetworkOutput& output = report.model.output;
  json depth;
  if (report.depth) {
    depth = json::object();
    for (std::size_t i = 0; i < NetworkReport::quantiles.size(); ++i)
      depth[fmt::format("{:g}", NetworkReport::quantiles[i])] = (*report.depth)[i];
  }
  json agreement;
  if (report.agreement) {
    agreement = {{"rank_correlation", report.agreement->rank_correlation}, {"points", report.agreement->points}};
    if (in_metres(report, frame)) agreement["lidar_over_network"] = report.agreement->scale;
  }
  json suspicions = json::array();
  for (const Suspicion& suspicion : report.suspicions)
    suspicions.push_back({{"code", suspicion.code}, {"seen", suspicion.seen}, {"remedy", suspicion.remedy}});
  return {
      {"schema", 1},
      {"descriptor", report.model.descriptor.string()},
      {"file", report.model.file.string()},
      {"sha256", report.model.sha256},
      {"input", {{"name", report.model.input.name}, {"width", report.input_width}, {"height", report.input_height}}},
      {"output", {{"name", output.name}, {"semantics", semantics_name(output.semantics)}}},
      {"golden_pair", report.model.golden.has_value()},
      {"remark", report.remark},
      {"frame", frame.name},
      {"run_ms", report.run_ms},
      {"valid_share", report.valid_share},
      {"unit", in_metres(report, frame) ? json("m") : json()},
      {"depth", depth},
      {"lower_over_upper", report.lower_over_upper ? json(*report.lower_over_upper) : json()},
      {"lidar", agreement},
      {"suspicions", suspicions}};
}

}  // namespace calib::ctl
