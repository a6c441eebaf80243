#include "calib/depth_model.hpp"
#include "fuzz/fuzz.hpp"

namespace calib::fuzz {

std::vector<Octets> seeds() {
  const std::string top = "file: network.onnx\nsha256: " + std::string(64, 'a') + "\n";
  return {
      octets(
          top +
          R"(input: {name: image, layout: nchw, channel_order: rgb, size: [320, 192], interpolation: area, scale: 1/255,
        mean: [0.485, 0.456, 0.406], std: [0.229, 0.224, 0.225], letterbox: centre, fill: [114, 114, 114]}
output: {name: depth, semantics: depth_metric, along: ray, canonical_focal_px: 1000, valid_range: [0.1, 300]}
golden: {image: golden.png, output: golden.f32, tolerance: 0.02}
)"),
      octets(top +
             R"(input: {name: image, layout: nhwc, channel_order: grey, size: [512, 256], keep_aspect: lower_bound,
        multiple_of: 14, interpolation: cubic, scale: 1}
output: {name: disparity, semantics: disparity_sigmoid, a: 9.99, b: 0.01}
)")};
}

void check(const DepthModel& model) {
  const NetworkInput& input = model.input;
  require(input.width >= 16 && input.width <= 4096 && input.height >= 16 && input.height <= 4096);
  require(input.multiple_of >= 1 && input.multiple_of <= std::min(input.width, input.height));
  const auto channels = static_cast<std::size_t>(input.channels());
  require(input.mean.size() == channels && input.std.size() == channels);
  require(!input.fill || input.fill->size() == channels);
  for (const double deviation : input.std) require(deviation > 0);
  require(model.sha256.size() == 64 && model.output.min < model.output.max && model.output.a > 0);
}

}  // namespace calib::fuzz

int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t size) {
  const auto model = calib::parse_depth_model(calib::fuzz::text(bytes, size), "m/model.yaml");
  if (model)
    calib::fuzz::check(*model);
  else
    calib::fuzz::require(model.error().code == calib::ErrorCode::bad_config &&
                         model.error().context.starts_with("m/model.yaml:"));
  return 0;
}
