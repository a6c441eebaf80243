#include "calib/depth_model.hpp"

#include <algorithm>
#include <initializer_list>
#include <utility>

#include "calib/config_node.hpp"

namespace calib {
namespace {

template <typename Value>
Value one_of(const ConfigNode& node, std::initializer_list<std::pair<std::string_view, Value>> known) {
  const std::string text = node.text();
  std::string names;
  for (const auto& [name, value] : known) {
    if (text == name) return value;
    names.append(names.empty() ? "" : ", ").append(name);
  }
  node.refuse("is none of: " + names);
}

/// A file, relative to the descriptor's folder.
std::filesystem::path path(const ConfigNode& node, const std::filesystem::path& descriptor) {
  return descriptor.parent_path() / node.text();
}

std::string read_sha256(const ConfigNode& node) {
  const std::string text = node.text();
  if (text.size() != 64 || text.find_first_not_of("0123456789abcdef") != std::string::npos)
    node.refuse("needs 64 lower-case hexadecimal digits, as sha256sum prints them");
  return text;
}

/// 1/255, which has no short decimal, may be written so.
double read_scale(const ConfigNode& node) { return node.text() == "1/255" ? 1.0 / 255 : node.number(1e-6, 1e6); }

void read_fit(const ConfigNode& node, NetworkInput& input) {
  const auto size = node.at("size").items();
  if (size.size() != 2) node.at("size").refuse("needs width and height in pixels");
  input.width = size[0].integer(16, 4096);
  input.height = size[1].integer(16, 4096);
  const auto aspect = node.find("keep_aspect"), multiple = node.find("multiple_of"), letterbox = node.find("letterbox"),
             fill = node.find("fill");
  if (aspect) input.fit = one_of<Fit>(*aspect, {{"lower_bound", Fit::lower_bound}, {"upper_bound", Fit::upper_bound}});
  if (multiple) {
    if (!aspect) multiple->refuse("is for networks of any size; write keep_aspect too, or remove it");
    input.multiple_of = multiple->integer(1, std::min(input.width, input.height));
  }
  if (letterbox) {
    if (aspect) letterbox->refuse("fills up a fixed size; remove it, or keep_aspect");
    input.fit = one_of<Fit>(*letterbox, {{"centre", Fit::letterbox_centre}, {"top_left", Fit::letterbox_top_left}});
  }
  if (fill) {
    if (!letterbox) fill->refuse("is the colour of a letterbox; write letterbox too, or remove it");
    input.fill = fill->numbers(input.channels(), 0, 255);
  }
}

NetworkInput read_input(const ConfigNode& node) {
  node.with_keys({"name", "layout", "channel_order", "size", "keep_aspect", "multiple_of", "letterbox", "fill",
                  "interpolation", "scale", "mean", "std"});
  NetworkInput input;
  input.name = node.at("name").text();
  input.layout = one_of<TensorLayout>(node.at("layout"), {{"nchw", TensorLayout::nchw}, {"nhwc", TensorLayout::nhwc}});
  input.channel_order = one_of<ChannelOrder>(
      node.at("channel_order"), {{"rgb", ChannelOrder::rgb}, {"bgr", ChannelOrder::bgr}, {"grey", ChannelOrder::grey}});
  read_fit(node, input);
  if (const auto interpolation = node.find("interpolation"))
    input.interpolation = one_of<Interpolation>(*interpolation, {{"nearest", Interpolation::nearest},
                                                                 {"linear", Interpolation::linear},
                                                                 {"cubic", Interpolation::cubic},
                                                                 {"area", Interpolation::area},
                                                                 {"lanczos", Interpolation::lanczos}});
  input.scale = read_scale(node.at("scale"));
  const auto channels = static_cast<std::size_t>(input.channels());
  const auto mean = node.find("mean"), std = node.find("std");
  input.mean = mean ? mean->numbers(channels, -1000, 1000) : std::vector<double>(channels, 0);
  input.std = std ? std->numbers(channels, 1e-6, 1000) : std::vector<double>(channels, 1);
  return input;
}

NetworkOutput read_output(const ConfigNode& node) {
  node.with_keys({"name", "semantics", "a", "b", "along", "canonical_focal_px", "valid_range"});
  NetworkOutput output;
  output.name = node.at("name").text();
  output.semantics =
      one_of<DepthSemantics>(node.at("semantics"), {{"inverse_relative", DepthSemantics::inverse_relative},
                                                    {"disparity", DepthSemantics::disparity},
                                                    {"disparity_sigmoid", DepthSemantics::disparity_sigmoid},
                                                    {"depth_relative", DepthSemantics::depth_relative},
                                                    {"depth_metric", DepthSemantics::depth_metric}});
  if (output.semantics == DepthSemantics::disparity_sigmoid) {
    output.a = node.at("a").number(1e-6, 1e6);
    output.b = node.at("b").number(0, 1e6);
  } else {
    for (const char* key : {"a", "b"})
      if (const auto unused = node.find(key)) unused->refuse("is for semantics disparity_sigmoid; remove it");
  }
  if (const auto along = node.find("along")) output.along_ray = one_of<bool>(*along, {{"axis", false}, {"ray", true}});
  if (const auto focal = node.find("canonical_focal_px")) {
    if (output.semantics != DepthSemantics::depth_metric) focal->refuse("is for semantics depth_metric; remove it");
    output.canonical_focal_px = focal->number(1, 1e5);
  }
  if (const auto range = node.find("valid_range")) {
    const auto limits = range->numbers(2, -1e9, 1e9);
    if (!(limits[0] < limits[1])) range->refuse("needs the least value, then the greatest");
    output.min = limits[0];
    output.max = limits[1];
  }
  return output;
}

GoldenPair read_golden(const ConfigNode& node, const std::filesystem::path& descriptor) {
  node.with_keys({"image", "output", "tolerance"});
  GoldenPair golden{path(node.at("image"), descriptor), path(node.at("output"), descriptor)};
  if (const auto tolerance = node.find("tolerance")) golden.tolerance = tolerance->number(0, 0.2);
  return golden;
}

DepthModel read_model(const ConfigNode& top, const std::filesystem::path& descriptor) {
  top.with_keys({"file", "sha256", "input", "output", "golden"});
  DepthModel model{.descriptor = descriptor,
                   .file = path(top.at("file"), descriptor),
                   .sha256 = read_sha256(top.at("sha256")),
                   .input = read_input(top.at("input")),
                   .output = read_output(top.at("output")),
                   .golden = {}};
  if (const auto golden = top.find("golden")) model.golden = read_golden(*golden, descriptor);
  return model;
}

}  // namespace

Result<DepthModel> parse_depth_model(std::string_view yaml, const std::filesystem::path& descriptor) {
  DepthModel model;
  const auto read =
      parse_config_text(yaml, descriptor, [&](const ConfigNode& top) { model = read_model(top, descriptor); });
  if (!read) return propagate(read);
  return model;
}

Result<DepthModel> load_depth_model(const std::filesystem::path& descriptor) {
  const auto yaml = read_config_text(descriptor);
  if (!yaml) return fail(yaml.error().code, yaml.error().context + "; give the YAML file that describes the network");
  return parse_depth_model(*yaml, descriptor);
}

}  // namespace calib
