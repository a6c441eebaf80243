#include <benchmark/benchmark.h>

#include <fstream>

#include "calib/depth_onnx.hpp"
#include "support/support.hpp"

using namespace calib;

namespace {

/// KITTI's size.
constexpr int width = 1242, height = 375;

double status_mb(const std::string& key) {
  std::ifstream status("/proc/self/status");
  for (std::string line; std::getline(status, line);)
    if (line.rfind(key + ":", 0) == 0) return std::stod(line.substr(key.size() + 1)) / 1024;
  return 0;
}

/// One estimate after the other, each from a whole colour image, and the memory that the process has in between. What
/// a setting costs in memory is told by a process that runs no other.
void network(benchmark::State& state) {
  const std::string name = "bench_" + std::to_string(state.range(0)) + "x" + std::to_string(state.range(0) * 3 / 10);
  const OnnxSettings settings{.threads = static_cast<int>(state.range(1)),
                              .spinning = state.range(2) != 0,
                              .memory_arena = state.range(3) != 0,
                              .keep_session = state.range(4) != 0};
  FramePair pair{
      .image = {{}, width, height, std::vector<std::uint8_t>(width * height)}, .right_image = {}, .scan = {}};
  for (int i = 0; i < 3 * width * height; ++i) pair.image.rgb.push_back(static_cast<std::uint8_t>(i * 7 % 251));
  const Camera camera = test::require_ok(Camera::make(CameraModel::rectified, width, height, {720, 720, 610, 173}));
  const double before_mb = status_mb("VmRSS"), own_before_mb = status_mb("RssAnon");
  const auto estimator =
      test::require_ok(make_onnx_depth(std::filesystem::path(DEPTH_MODELS) / (name + ".yaml"), camera, settings));
  [[maybe_unused]] const std::string remark = test::require_ok(estimator->prepare());
  for (auto _ : state) benchmark::DoNotOptimize(test::require_ok(estimator->estimate(pair)));
  state.counters["resident_MB"] = status_mb("VmRSS");
  state.counters["added_MB"] = status_mb("VmRSS") - before_mb;
  state.counters["added_own_MB"] = status_mb("RssAnon") - own_before_mb;
  state.counters["peak_MB"] = status_mb("VmHWM");
}

void settings_of(benchmark::internal::Benchmark* benchmark) {
  benchmark->ArgNames({"width", "threads", "spinning", "arena", "keep"});
  for (const int network_width : {320, 640}) {
    benchmark->Args({network_width, 1, 0, 0, 1});
    benchmark->Args({network_width, 1, 0, 1, 1});
    benchmark->Args({network_width, 1, 0, 0, 0});
    benchmark->Args({network_width, 2, 0, 0, 1});
    benchmark->Args({network_width, 2, 1, 0, 1});
    benchmark->Args({network_width, 2, 1, 1, 1});
  }
}

// Once through, so that the memory is that of one estimator.
BENCHMARK(network)
    ->Apply(settings_of)
    ->Unit(benchmark::kMillisecond)
    ->MeasureProcessCPUTime()
    ->UseRealTime()
    ->Iterations(20);

}  // namespace

BENCHMARK_MAIN();
