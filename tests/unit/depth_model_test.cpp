#include "calib/depth_model.hpp"

#include "support/catch.hpp"
#include "support/support.hpp"

using namespace calib;
using Catch::Matchers::ContainsSubstring;
using test::require_ok;

namespace {

const std::string sha256(64, 'a');
const std::string head = "file: network.onnx\nsha256: " + sha256 + "\n";
const std::string input = "input: {name: image, layout: nchw, channel_order: rgb, size: [640, 192], scale: 1/255}\n";
const std::string output = "output: {name: depth, semantics: inverse_relative}\n";

Result<DepthModel> parse(const std::string& yaml) { return parse_depth_model(yaml, "/models/network.yaml"); }

std::string replaced(std::string text, const std::string& what, const std::string& by) {
  const auto at = text.find(what);
  REQUIRE(at != std::string::npos);
  return text.replace(at, what.size(), by);
}

}  // namespace

TEST_CASE("Depth Anything V2: any size of multiples of 14 that covers 518 x 518, ImageNet's mean, inverse depth") {
  const DepthModel model = require_ok(parse(R"(
file: depth_anything_v2_vits.onnx
sha256: 0123456789abcdef0123456789abcdef0123456789abcdef0123456789abcdef
input:
  name: pixel_values
  layout: nchw
  channel_order: rgb
  size: [518, 518]
  keep_aspect: lower_bound
  multiple_of: 14
  interpolation: cubic
  scale: 1/255
  mean: [0.485, 0.456, 0.406]
  std: [0.229, 0.224, 0.225]
output:
  name: predicted_depth
  semantics: inverse_relative
golden:
  image: golden.png
  output: golden.f32
  tolerance: 0.02
)"));
  CHECK(model.descriptor == "/models/network.yaml");
  CHECK(model.file == "/models/depth_anything_v2_vits.onnx");
  CHECK(model.sha256 == "0123456789abcdef0123456789abcdef0123456789abcdef0123456789abcdef");
  CHECK(model.input.name == "pixel_values");
  CHECK(model.input.fit == Fit::lower_bound);
  CHECK(model.input.multiple_of == 14);
  CHECK(model.input.interpolation == Interpolation::cubic);
  CHECK(model.input.scale == 1.0 / 255);
  CHECK(model.input.mean == std::vector<double>{0.485, 0.456, 0.406});
  CHECK(model.input.std == std::vector<double>{0.229, 0.224, 0.225});
  CHECK(model.output.name == "predicted_depth");
  CHECK(model.output.semantics == DepthSemantics::inverse_relative);
  CHECK_FALSE(model.output.along_ray);
  CHECK(model.golden.value().image == "/models/golden.png");
  CHECK(model.golden->output == "/models/golden.f32");
  CHECK(model.golden->tolerance == 0.02);
}

TEST_CASE("MiDaS v2.1 small: 256 x 256 and nothing else, normalised inside") {
  const DepthModel model = require_ok(parse(head + R"(
input: {name: "0", layout: nhwc, channel_order: bgr, size: [256, 256], interpolation: area, scale: 1}
output: {name: "797", semantics: inverse_relative}
)"));
  CHECK(model.input.layout == TensorLayout::nhwc);
  CHECK(model.input.channel_order == ChannelOrder::bgr);
  CHECK(model.input.fit == Fit::stretch);
  CHECK(model.input.width == 256);
  CHECK(model.input.mean == std::vector<double>{0, 0, 0});
  CHECK(model.input.std == std::vector<double>{1, 1, 1});
  CHECK_FALSE(model.golden.has_value());
}

TEST_CASE("DPT, MiDaS 3: within 384 x 384, multiples of 32") {
  const DepthModel model = require_ok(parse(head + R"(
input:
  {name: input, layout: nchw, channel_order: rgb, size: [384, 384], keep_aspect: upper_bound, multiple_of: 32,
   interpolation: cubic, scale: 1/255, mean: [0.5, 0.5, 0.5], std: [0.5, 0.5, 0.5]}
output: {name: output, semantics: inverse_relative}
)"));
  CHECK(model.input.fit == Fit::upper_bound);
  CHECK(model.input.multiple_of == 32);
}

TEST_CASE("Monodepth2, Lite-Mono, FeatDepth: the sigmoid of a disparity within two depths") {
  const DepthModel model = require_ok(parse(head + R"(
input: {name: image, layout: nchw, channel_order: rgb, size: [1024, 320], interpolation: lanczos, scale: 1/255}
output: {name: disp_0, semantics: disparity_sigmoid, a: 9.99, b: 0.01, valid_range: [0, 1]}
)"));
  CHECK(model.input.interpolation == Interpolation::lanczos);
  CHECK(model.output.semantics == DepthSemantics::disparity_sigmoid);
  CHECK(model.output.a == 9.99);
  CHECK(model.output.b == 0.01);
  CHECK(model.output.min == 0);
  CHECK(model.output.max == 1);
}

TEST_CASE("Metric3D v2: letterboxed, metres as a camera of 1000 pixels of focal length would see them") {
  const DepthModel model = require_ok(parse(head + R"(
input:
  {name: pixel_values, layout: nchw, channel_order: rgb, size: [1064, 616], letterbox: centre, interpolation: linear,
   scale: 1, mean: [123.675, 116.28, 103.53], std: [58.395, 57.12, 57.375]}
output: {name: predicted_depth, semantics: depth_metric, canonical_focal_px: 1000, valid_range: [0.3, 200]}
)"));
  CHECK(model.input.fit == Fit::letterbox_centre);
  CHECK_FALSE(model.input.fill.has_value());
  CHECK(model.output.semantics == DepthSemantics::depth_metric);
  CHECK(model.output.canonical_focal_px == 1000.0);
}

TEST_CASE("UniDepth, Depth Anything 3 metric: letterboxed in a colour, metres along the ray") {
  const DepthModel model = require_ok(parse(head + R"(
input:
  {name: rgbs, layout: nchw, channel_order: rgb, size: [630, 476], letterbox: top_left, fill: [114, 114, 114],
   scale: 1/255, mean: [0.485, 0.456, 0.406], std: [0.229, 0.224, 0.225]}
output: {name: distance, semantics: depth_metric, along: ray}
)"));
  CHECK(model.input.fit == Fit::letterbox_top_left);
  CHECK(model.input.fill == std::vector<double>{114, 114, 114});
  CHECK(model.output.along_ray);
}

TEST_CASE("other networks: grey images, disparities, relative depth") {
  const DepthModel model = require_ok(parse(head + R"(
input:
  {name: image, layout: nchw, channel_order: grey, size: [320, 96], interpolation: nearest, scale: 0.004, mean: [0.4], std: [0.2]}
output: {name: depth, semantics: depth_relative}
)"));
  CHECK(model.input.channels() == 1);
  CHECK(model.input.scale == 0.004);
  CHECK(require_ok(parse(head + input + replaced(output, "inverse_relative", "disparity"))).output.semantics ==
        DepthSemantics::disparity);
}

TEST_CASE("a wrong descriptor is refused in one line with its file, line and key") {
  struct Wrong {
    std::string what, instead, refusal;
  };
  const std::string all = head + input + output;
  REQUIRE(parse(all).has_value());
  const Wrong wrongs[] = {
      {"file: network.onnx\n", "", "1: file: missing"},
      {"file:", "model:", "1: model: unknown key; known keys are file, sha256, input, output, golden"},
      {sha256, "abc", "2: sha256: needs 64 lower-case hexadecimal digits"},
      {sha256, std::string(64, 'A'), "2: sha256: needs 64"},
      {"nchw", "chw", "3: input.layout: is none of: nchw, nhwc"},
      {"layout: nchw, ", "", "3: input.layout: missing"},
      {"channel_order: rgb", "channel_order: bayer", "3: input.channel_order: is none of: rgb, bgr, grey"},
      {"[640, 192]", "[640]", "3: input.size: needs width and height"},
      {"[640, 192]", "[640, 5000]", "3: input.size[1]: 5000 is outside 16 .. 4096"},
      {"[640, 192]", "[640, high]", "3: input.size[1]: needs a whole number"},
      {"scale: 1/255", "scale: 1/256", "3: input.scale: needs a number"},
      {"scale: 1/255", "scale: 0", "3: input.scale: 0 is outside"},
      {"scale: 1/255", "scale: 1, mean: [0.5]", "3: input.mean: needs a list of 3 numbers"},
      {"scale: 1/255", "scale: 1, std: [1, 1, 0]", "3: input.std[2]: 0 is outside"},
      {"scale: 1/255", "scale: 1, multiple_of: 14", "3: input.multiple_of: is for networks of any size"},
      {"scale: 1/255", "scale: 1, keep_aspect: true", "3: input.keep_aspect: is none of: lower_bound, upper_bound"},
      {"scale: 1/255", "scale: 1, keep_aspect: upper_bound, multiple_of: 500", "3: input.multiple_of: 500 is outside"},
      {"scale: 1/255", "scale: 1, keep_aspect: upper_bound, letterbox: centre", "3: input.letterbox: fills up a fixed"},
      {"scale: 1/255", "scale: 1, letterbox: left", "3: input.letterbox: is none of: centre, top_left"},
      {"scale: 1/255", "scale: 1, fill: [0, 0, 0]", "3: input.fill: is the colour of a letterbox"},
      {"scale: 1/255", "scale: 1, interpolation: best", "3: input.interpolation: is none of: nearest, linear"},
      {"scale: 1/255", "scale: 1, scale: 2", "3: input.scale: given twice"},
      {"inverse_relative", "depth", "4: output.semantics: is none of: inverse_relative, disparity, disparity_sigmoid"},
      {"inverse_relative", "disparity_sigmoid, b: 0.01", "4: output.a: missing"},
      {"inverse_relative", "inverse_relative, a: 1", "4: output.a: is for semantics disparity_sigmoid"},
      {"inverse_relative", "inverse_relative, along: z", "4: output.along: is none of: axis, ray"},
      {"inverse_relative", "depth_relative, canonical_focal_px: 1000",
       "4: output.canonical_focal_px: is for semantics"},
      {"inverse_relative", "inverse_relative, valid_range: [2, 1]", "4: output.valid_range: needs the least value"},
      {output, output + "golden: {image: a.png}\n", "5: golden.output: missing"},
      {output, output + "golden: {image: a.png, output: a.f32, tolerance: 1}\n", "5: golden.tolerance: 1 is outside"},
      {output, "output: [depth]\n", "4: output: needs a mapping with the keys name, semantics"},
      {all, "file: [\n", ": not YAML"},
      {all, "", "1: the file must hold one YAML document"},
  };
  for (const Wrong& wrong : wrongs) {
    const auto model = parse(replaced(all, wrong.what, wrong.instead));
    INFO(wrong.refusal);
    REQUIRE_FALSE(model.has_value());
    CHECK(model.error().code == "bad_config");
    CHECK_THAT(model.error().context, ContainsSubstring("/models/network.yaml:"));
    CHECK_THAT(model.error().context, ContainsSubstring(wrong.refusal));
    CHECK(model.error().context.find('\n') == std::string::npos);
  }
}

TEST_CASE("a descriptor that is not there is named") {
  const auto model = load_depth_model("/nowhere/network.yaml");
  CHECK(model.error().code == "config_not_found");
  CHECK_THAT(model.error().context, ContainsSubstring("/nowhere/network.yaml"));
}
