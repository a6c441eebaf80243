#include "calib/depth_onnx.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <fstream>
#include <thread>

#include "support/catch.hpp"
#include "support/support.hpp"

using namespace calib;
using Catch::Matchers::ContainsSubstring;
using test::require_ok;

namespace {

// make_depth_models.py knows them too.
constexpr int width = 320, height = 96;
constexpr double focal_px = 200;
const std::filesystem::path models = DEPTH_MODELS;

Camera camera() {
  return require_ok(Camera::make(CameraModel::rectified, width, height, {focal_px, focal_px, width / 2, height / 2}));
}

auto network(const std::string& name, const OnnxSettings& settings = {}) {
  return require_ok(make_onnx_depth(models / (name + ".yaml"), camera(), settings));
}

/// Red grows to the right, green downwards and blue to the left; or all of them alike.
FramePair slope(bool colour) {
  FramePair pair{.image = {{}, width, height, {}}, .right_image = {}, .scan = {}};
  for (int v = 0; v < height; ++v)
    for (int u = 0; u < width; ++u) {
      const auto red = static_cast<std::uint8_t>(10 + 230 * u / width),
                 green = static_cast<std::uint8_t>(10 + 230 * v / height);
      const auto blue = static_cast<std::uint8_t>(200 - 100 * u / width);
      pair.image.pixels.push_back(red);
      if (colour) pair.image.rgb.insert(pair.image.rgb.end(), {red, green, blue});
    }
  return pair;
}

/// What every convention's network computes of the pixel `i`.
double expected(const Image& image, std::size_t i) {
  if (image.rgb.empty()) return (image.pixels[i] + 5) / 260.0;
  return (0.5 * image.rgb[3 * i] + 0.3 * image.rgb[3 * i + 1] + 0.2 * image.rgb[3 * i + 2] + 5) / 260;
}

struct Difference {
  double mean = 0, greatest = 0;
};

Difference difference(const DepthMap& depth, const Image& image) {
  REQUIRE(depth.inverse_depth.size() == image.pixels.size());
  Difference difference;
  for (std::size_t i = 0; i < depth.inverse_depth.size(); ++i) {
    const double error = depth.inverse_depth[i] - expected(image, i);
    difference.mean += error / static_cast<double>(image.pixels.size());
    difference.greatest = std::max(difference.greatest, std::abs(error));
  }
  return difference;
}

std::string refusal(DepthEstimator& estimator) {
  const auto prepared = estimator.prepare();
  REQUIRE_FALSE(prepared.has_value());
  CHECK(prepared.error().code == "depth_failed");
  CHECK(prepared.error().context.find('\n') == std::string::npos);
  // What was refused once gives no depth either.
  CHECK(estimator.estimate(slope(true)).error().code == "depth_failed");
  return prepared.error().context;
}

void copy_model(const std::string& name, const std::filesystem::path& folder) {
  for (const char* extension : {".onnx", ".yaml", ".png", ".f32"})
    std::filesystem::copy(models / (name + extension), folder);
}

}  // namespace

TEST_CASE("networks of every convention see the same depth in the same image, and pass their self-test") {
  for (const std::string name : {"depth_anything", "midas_small", "dpt", "monodepth2", "metric3d", "unidepth",
                                 "channels_last", "fixed_output", "grey"}) {
    const auto estimator = network(name);
    INFO(name);
    CHECK(require_ok(estimator->prepare()).empty());
    for (const bool colour : {true, false}) {
      if (colour && name == "grey") continue;
      const FramePair pair = slope(colour);
      const DepthMap depth = require_ok(estimator->estimate(pair));
      CHECK(depth.width == width);
      CHECK(depth.height == height);
      CHECK(depth.along_ray == (name == "unidepth"));
      // Bytes are rounded when the image is resized. Half a pixel off would be 7e-4 on average.
      const Difference off = difference(depth, pair.image);
      CHECK(off.greatest < 0.01);
      CHECK(std::abs(off.mean) < 5e-4);
    }
  }
}

TEST_CASE("the same network gives the same depth whatever its settings are") {
  const FramePair pair = slope(true);
  const auto depth = [&](const std::string& name, const OnnxSettings& settings) {
    return require_ok(network(name, settings)->estimate(pair)).inverse_depth;
  };
  for (const std::string name : {"bench_320x96", "metric3d"}) {
    const auto plain = depth(name, {});
    CHECK(plain == depth(name, {.threads = 2}));
    CHECK(plain == depth(name, {.threads = 2, .spinning = true, .memory_arena = true}));
    CHECK(plain == depth(name, {.keep_session = false}));
  }
  const auto dropped = network("bench_320x96", {.keep_session = false});
  const auto first = require_ok(dropped->estimate(pair)).inverse_depth;
  CHECK(first == require_ok(dropped->estimate(pair)).inverse_depth);
}

TEST_CASE("a network without a golden pair runs, and that it is not tested is said") {
  const auto estimator = network("good");
  CHECK_THAT(require_ok(estimator->prepare()), ContainsSubstring("names no golden pair"));
  CHECK(difference(require_ok(estimator->estimate(slope(true))), slope(true).image).greatest < 0.01);
}

TEST_CASE("a network that does not make of its golden picture what it should fails its self-test") {
  const test::TemporaryFolder folder;
  copy_model("metric3d", folder.path());
  const auto prepared = [&] {
    return require_ok(make_onnx_depth(folder.path() / "metric3d.yaml", camera(), {}))->prepare();
  };
  REQUIRE(prepared().has_value());

  SECTION("other preprocessing") {
    std::ifstream in(models / "metric3d.yaml");
    std::string yaml{std::istreambuf_iterator<char>(in), {}};
    yaml.replace(yaml.find("rgb"), 3, "bgr");
    std::ofstream(folder.path() / "metric3d.yaml") << yaml;
    CHECK_THAT(prepared().error().context, ContainsSubstring("differs from"));
  }
  SECTION("an output of another size") { std::filesystem::resize_file(folder.path() / "metric3d.f32", 400); }
  SECTION("more than the output") {
    std::ofstream(folder.path() / "metric3d.f32", std::ios::app | std::ios::binary) << "more";
  }
  SECTION("one value that is no number") {
    const float not_a_number = std::nanf("");
    std::fstream file(folder.path() / "metric3d.f32", std::ios::in | std::ios::out | std::ios::binary);
    file.seekp(4000);
    file.write(reinterpret_cast<const char*>(&not_a_number), sizeof not_a_number);
  }
  SECTION("one value that is another") {
    const float other = 1e4F;
    std::fstream file(folder.path() / "metric3d.f32", std::ios::in | std::ios::out | std::ios::binary);
    file.seekp(4000);
    file.write(reinterpret_cast<const char*>(&other), sizeof other);
  }
  SECTION("no output") { std::filesystem::remove(folder.path() / "metric3d.f32"); }
  SECTION("a picture that is neither PNG nor JPEG") {
    std::ofstream(folder.path() / "metric3d.png") << "P5 2 2 255\nabcd";
  }
  SECTION("a picture that breaks off") { std::filesystem::resize_file(folder.path() / "metric3d.png", 200); }
  SECTION("no picture") { std::ofstream(folder.path() / "metric3d.png") << "no picture"; }

  const auto result = prepared();
  REQUIRE_FALSE(result.has_value());
  CHECK(result.error().code == "depth_failed");
  CHECK(result.error().context.rfind("depth model self-test failed: ", 0) == 0);
}

TEST_CASE("a model file that is not the pinned one is refused before it is parsed") {
  const test::TemporaryFolder folder;
  copy_model("metric3d", folder.path());
  const auto refused = [&] {
    const auto estimator = require_ok(make_onnx_depth(folder.path() / "metric3d.yaml", camera(), {}));
    return refusal(*estimator);
  };
  std::ofstream(folder.path() / "metric3d.onnx", std::ios::app | std::ios::binary) << '\0';
  CHECK_THAT(refused(), ContainsSubstring("metric3d.onnx: its SHA-256 is ") && ContainsSubstring("metric3d.yaml pins"));
  std::filesystem::resize_file(folder.path() / "metric3d.onnx",
                               (std::uintmax_t{1} << 30) + 1);  // takes no room on disk
  CHECK_THAT(refused(), ContainsSubstring("larger than 1 GiB"));
  std::filesystem::remove(folder.path() / "metric3d.onnx");
  std::filesystem::create_directory(folder.path() / "metric3d.onnx");
  CHECK_THAT(refused(), ContainsSubstring("cannot be read"));
}

TEST_CASE("a network whose weights are in another file is refused, wherever in the graph they are named") {
  for (const std::string name : {"external", "external_constant", "external_branch"}) {
    INFO(name);
    CHECK_THAT(refusal(*network(name)), ContainsSubstring(name + ".onnx: keeps its weights in other files"));
  }
  // One that was put together again still says of each tensor where it is.
  CHECK(difference(require_ok(network("internal_again")->estimate(slope(true))), slope(true).image).greatest < 0.01);
}

TEST_CASE("an error of a network names its file and the remedy") {
  const std::array<std::array<std::string, 3>, 15> wrongs{{
      {"unknown_operator", "Foresee", "export the network again"},
      {"future_ir", "cannot load it", "export the network again"},
      {"text", "is not an ONNX model", "export"},
      {"cut", "is not an ONNX model", "export"},
      {"other_input", "has no input picture", "write image as input.name"},
      {"two_inputs", "takes 2 inputs (image, intrinsics)", "export it with the image as the only one"},
      {"bytes", "its input image is no tensor of 32-bit floats", "export"},
      {"rank_three_input", "its input image is 3 x 96 x 320", "correct input.layout"},
      {"other_size", "is 1 x 3 x 96 x 320 where", "asks for 1 x 3 x 192 x 640"},
      {"other_layout", "asks for 1 x 96 x 320 x 3", "correct input.layout"},
      {"other_channels", "asks for 1 x 1 x 96 x 320", "correct input.layout, size or channel_order"},
      {"other_output", "has no output disparity; its outputs are depth", "output.name"},
      {"three_maps", "its output depth is 1 x 3 x 96 x 320", "choose another output.name"},
      {"flat", "its output depth is 1 x 30720", "choose another output.name"},
      {"not_a_number", "NaN", "check scale, mean and std"},
  }};
  for (const auto& [name, what, remedy] : wrongs) {
    const std::string context = refusal(*network(name));
    INFO(context);
    CHECK_THAT(context, ContainsSubstring((models / (name + ".onnx")).string().substr(0, models.string().size())));
    CHECK_THAT(context, ContainsSubstring(".onnx: ") && ContainsSubstring(what) && ContainsSubstring(remedy));
  }
  CHECK_THAT(refusal(*network("not_there")), ContainsSubstring("nowhere.onnx: cannot be read"));
}

TEST_CASE("what is behind the camera, infinite or out of range has no depth") {
  const FramePair pair = slope(true);
  for (const std::string name : {"negative", "infinite"}) {
    const DepthMap depth = require_ok(network(name)->estimate(pair));
    for (std::size_t i = 0; i < depth.inverse_depth.size(); ++i) {
      const double q = expected(pair.image, i);
      if (std::abs(q - 0.5) < 1e-6) continue;
      REQUIRE((depth.inverse_depth[i] > 0) == (q > 0.5));
      REQUIRE(std::isfinite(depth.inverse_depth[i]));
    }
  }
  // 0.3 .. 300 m are valid to this one: an image black all over is at 52 m, and taken for 52 km by another camera's
  // lens.
  const auto far = require_ok(Camera::make(CameraModel::rectified, width, height, {2e4, 2e4, 160, 48}));
  const auto estimator = require_ok(make_onnx_depth(models / "metric3d.yaml", far, {}));
  FramePair black = slope(false);
  std::ranges::fill(black.image.pixels, std::uint8_t{0});
  CHECK(require_ok(estimator->estimate(black)).valid_share() == 0);
  CHECK(require_ok(network("metric3d")->estimate(black)).valid_share() == 1);
}

TEST_CASE("an execution provider that is missing is remarked, and the CPU used") {
  const auto depth = require_ok(network("metric3d")->estimate(slope(true))).inverse_depth;
  for (const std::string provider : {"cuda", "TensorRT", "OpenVINOExecutionProvider", "abacus"}) {
    const auto estimator = network("metric3d", {.execution_provider = provider});
    CHECK_THAT(require_ok(estimator->prepare()),
               ContainsSubstring("is not available") && ContainsSubstring("CPU is used"));
    CHECK(require_ok(estimator->estimate(slope(true))).inverse_depth == depth);
  }
  CHECK(require_ok(network("metric3d", {.execution_provider = "CPUExecutionProvider"})->prepare()).empty());
}

TEST_CASE("a cancelled network gives no depth any more") {
  const auto estimator = network("metric3d");
  REQUIRE(estimator->prepare().has_value());
  REQUIRE(estimator->estimate(slope(true)).has_value());
  estimator->cancel();
  CHECK(estimator->estimate(slope(true)).error().code == "depth_failed");
  CHECK(estimator->prepare().error().code == "depth_failed");
}

TEST_CASE("a network that is running is cancelled from another thread") {
  const auto estimator = network("bench_640x192");
  const FramePair pair = slope(true);
  REQUIRE(estimator->estimate(pair).has_value());
  std::thread other([&] { estimator->cancel(); });
  while (estimator->estimate(pair)) {
  }
  other.join();
}

TEST_CASE("an image of another size than the camera's has no depth") {
  FramePair pair = slope(true);
  std::swap(pair.image.width, pair.image.height);
  CHECK_THAT(network("metric3d")->estimate(pair).error().context, ContainsSubstring("an image is 96 x 320"));
}

TEST_CASE("no network is made for images that would become too large for it") {
  const auto strip = require_ok(Camera::make(CameraModel::rectified, 65535, 16, {100, 100, 0, 0}));
  CHECK_THAT(make_onnx_depth(models / "depth_anything.yaml", strip, {}).error().context,
             ContainsSubstring("write a smaller size, or keep_aspect: upper_bound"));
}
