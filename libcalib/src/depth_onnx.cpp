#include "calib/depth_onnx.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <opencv2/core.hpp>
#include <span>
#include <utility>

#include "calib/depth_model.hpp"
#include "calib/file.hpp"
#include "calib/image_codec.hpp"
#include "calib/image_header.hpp"
#include "network_image.hpp"
#include "onnx_network.hpp"

namespace calib {
namespace {

tl::unexpected<Error> self_test_failed(const std::string& what) {
  return fail(ErrorCode::depth_failed, "depth model self-test failed: " + what);
}

Result<Image> read_golden_image(const std::filesystem::path& file) {
  constexpr std::uint64_t most_bytes = 64 << 20;
  auto bytes = read_regular_file(file, most_bytes);
  if (!bytes) return self_test_failed(bytes.error().context);
  const std::span encoded(reinterpret_cast<const std::uint8_t*>(bytes->data()), bytes->size());
  const auto header = read_image_header(*bytes);
  const auto compression = compression_of(encoded);
  if (!header || !header->in_bounds() || !compression)
    return self_test_failed(file.string() + " is no PNG or JPEG of 1 .. 64 Mpx");
  Image image{{}, static_cast<int>(header->width), static_cast<int>(header->height), {}};
  for (const auto& [channels, pixels] : {std::pair{1, &image.pixels}, std::pair{3, &image.rgb}}) {
    const PixelLayout layout{image.width, image.height, channels};
    pixels->resize(layout.bytes());
    if (const auto decoded = decode_pixels(encoded, *compression, layout, *pixels); !decoded)
      return self_test_failed(file.string() + ": " + decoded.error().context);
  }
  return image;
}

/// Nothing unless the file holds just so many finite numbers.
std::optional<std::vector<float>> read_floats(const std::filesystem::path& file, std::size_t count) {
  const auto bytes = read_regular_file(file, count * sizeof(float));
  if (!bytes || bytes->size() != count * sizeof(float)) return std::nullopt;
  std::vector<float> values(count);
  std::memcpy(values.data(), bytes->data(), bytes->size());
  if (!std::ranges::all_of(values, [](float value) { return std::isfinite(value); })) return std::nullopt;
  return values;
}

Result<void> compare(const NetworkMap& map, const DepthModel& model) {
  const GoldenPair& golden = *model.golden;
  const auto expected = read_floats(golden.output, map.values.size());
  if (!expected)
    return self_test_failed(fmt::format("{} does not hold the {} x {} finite 32-bit floats that {} makes of {}",
                                        golden.output.string(), map.width, map.height, model.file.string(),
                                        golden.image.string()));
  const auto [least, greatest] = std::ranges::minmax(*expected);
  double difference = 0;
  for (std::size_t i = 0; i < expected->size(); ++i)
    difference = std::max(difference, std::abs(static_cast<double>(map.values[i]) - (*expected)[i]));
  const double share = difference / (static_cast<double>(greatest) - least);
  if (share <= golden.tolerance) return {};  // false where all golden values are the same
  return self_test_failed(fmt::format(
      "{} makes of {} what differs from {} by {:f} of its range, and {:f} is tolerated; check input and output in {}",
      model.file.string(), golden.image.string(), golden.output.string(), share, golden.tolerance,
      model.descriptor.string()));
}

/// A slope from black to white, of the camera's size.
Image slope(const Camera& camera) {
  Image image{{}, camera.width(), camera.height(), {}};
  for (int v = 0; v < image.height; ++v)
    for (int u = 0; u < image.width; ++u) image.pixels.push_back(static_cast<std::uint8_t>(255 * u / image.width));
  return image;
}

class OnnxDepth final : public DepthEstimator {
 public:
  OnnxDepth(DepthModel model, const Camera& camera, const OnnxSettings& settings)
      : model_(std::move(model)), camera_(camera), network_(model_, settings) {}

  Result<std::string> prepare() override {
    const auto tested = self_test();
    network_.rest();
    proven_ = tested.has_value();
    if (!tested) return propagate(tested);
    std::string remark = network_.remark();
    if (!model_.golden)
      remark += (remark.empty() ? "" : "; ") + model_.descriptor.string() +
                " names no golden pair: nothing tests at start whether the network gives the depth it should";
    return remark;
  }

  Result<DepthMap> estimate(const FramePair& pair) override {
    if (pair.image.width != camera_.width() || pair.image.height != camera_.height())
      return fail(ErrorCode::depth_failed,
                  fmt::format("an image is {} x {} where the configuration says {} x {}", pair.image.width,
                              pair.image.height, camera_.width(), camera_.height()));
    // What has not passed its self-test gives no depth.
    if (!proven_)
      if (const auto prepared = prepare(); !prepared) return propagate(prepared);
    const Placement placement = place(model_.input, pair.image.width, pair.image.height);
    const auto map = run(pair.image, placement);
    network_.rest();
    if (!map) return propagate(map);
    return to_depth(model_.output, placement, *map, camera_);
  }

  void cancel() override { network_.cancel(); }

 private:
  Result<NetworkMap> run(const Image& image, const Placement& placement) {
    if (auto loaded = network_.load(); !loaded) return propagate(loaded);
    try {
      return network_.run(to_tensor(model_.input, placement, image), placement);
    } catch (const cv::Exception& exception) {
      return fail(ErrorCode::depth_failed,
                  std::string("an image cannot be made of the network's size: ") + exception.what());
    }
  }

  /// Without a golden pair: that the network runs, and what comes out has the form of a depth map.
  Result<void> self_test() {
    if (auto loaded = network_.load(); !loaded) return loaded;
    const auto image = model_.golden ? read_golden_image(model_.golden->image) : slope(camera_);
    if (!image) return propagate(image);
    const auto map = run(*image, place(model_.input, image->width, image->height));
    if (!map) return propagate(map);
    return model_.golden ? compare(*map, model_) : Result<void>();
  }

  DepthModel model_;
  Camera camera_;
  bool proven_ = false;
  OnnxNetwork network_;
};

}  // namespace

bool has_onnx() { return true; }

Result<std::unique_ptr<DepthEstimator>> make_onnx_depth(const std::filesystem::path& descriptor, const Camera& camera,
                                                        const OnnxSettings& settings) {
  if (const auto loaded = load_onnx_runtime(); !loaded) return propagate(loaded);
  auto model = load_depth_model(descriptor);
  if (!model) return propagate(model);
  // An image that is much longer than high, covering a nominal size.
  constexpr std::int64_t most_pixels = 1 << 24;
  const Placement placement = place(model->input, camera.width(), camera.height());
  if (std::int64_t{placement.width} * placement.height > most_pixels)
    return fail(ErrorCode::bad_config,
                fmt::format("{}: input.size: an image of {} x {} becomes one of {} x {}; write a smaller size, or "
                            "keep_aspect: upper_bound",
                            descriptor.string(), camera.width(), camera.height(), placement.width, placement.height));
  try {
    return std::make_unique<OnnxDepth>(*std::move(model), camera, settings);
  } catch (const Ort::Exception& exception) {
    return fail(ErrorCode::depth_failed, std::string("ONNX Runtime does not start: ") + exception.what());
  }
}

}  // namespace calib
