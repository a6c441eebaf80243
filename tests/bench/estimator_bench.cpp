#include <benchmark/benchmark.h>

#include "calib/depth_stereo.hpp"
#include "calib/drift.hpp"
#include "calib/recalibrate.hpp"
#include "support/simulated_drive.hpp"
#include "vehicle/vehicle.hpp"

using namespace calib;

namespace {

/// KITTI's size: a 64-beam LiDAR all around and a 1242 x 375 camera.
constexpr int width = 1242, height = 375;
constexpr vehicle::LidarModel lidar{.azimuth_step_deg = 0.17};
constexpr int fitted = 25, held_back = 6;

test::SimulatedDrive& drive() {
  static test::SimulatedDrive drive(1, width, height, lidar);
  return drive;
}

const std::vector<FeatureSet>& frames() {
  static const auto frames = drive().features_of(fitted + held_back, test::knock(0, 0, 1));
  return frames;
}

void time_per_point(benchmark::State& state, std::size_t points) {
  state.counters["points"] = static_cast<double>(points);
  state.counters["each"] = benchmark::Counter(
      static_cast<double>(points), benchmark::Counter::kIsIterationInvariantRate | benchmark::Counter::kInvert);
}

void score_of_a_frame(benchmark::State& state) {
  const FeatureSet& frame = frames().front();
  Objective objective;
  objective.terms[0].ranks_per_class = static_cast<int>(state.range(0));
  for (auto _ : state) benchmark::DoNotOptimize(score(frame, drive().T_camera_lidar(), objective));
  time_per_point(state, frame.x_m.size());
}

/// What a score cannot do without: read a point's coordinates and rank, read one pixel, increment one count.
void memory_floor(benchmark::State& state) {
  const FeatureSet& frame = frames().front();
  const std::size_t pixels_per_point = frame.planes->packed.size() / frame.x_m.size();
  std::vector<std::uint32_t> counts(64 * 64);
  for (auto _ : state) {
    for (std::size_t i = 0; i < frame.x_m.size(); ++i) {
      const std::uint16_t pixel = frame.planes->packed[i * pixels_per_point];
      counts[frame.range_rank[i] / 4 * 64 + (pixel & 63)] += frame.x_m[i] + frame.y_m[i] + frame.z_m[i] > -1e6F;
    }
    benchmark::ClobberMemory();
  }
  time_per_point(state, frame.x_m.size());
}

void stencil_of_a_frame(benchmark::State& state) {
  const FeatureSet& frame = frames().front();
  for (auto _ : state) benchmark::DoNotOptimize(evaluate_stencil(frame, drive().T_camera_lidar()));
  time_per_point(state, 13 * frame.x_m.size());
}

void features_of_a_pair(benchmark::State& state) {
  const DepthMap depth = drive().depth(0);
  const FramePair pair = drive().pair(0);
  std::size_t bytes = 0;
  for (auto _ : state)
    bytes = test::require_ok(make_features(pair, depth, drive().camera(), drive().T_camera_lidar())).memory_bytes();
  state.counters["points_in_scan"] = static_cast<double>(pair.scan.points.size());
  state.counters["bytes_kept"] = static_cast<double>(bytes);
}

void stereo_depth_of_a_pair(benchmark::State& state) {
  vehicle::Simulation simulation;
  simulation.width = width;
  simulation.height = height;
  const auto vehicle = test::require_ok(vehicle::simulated_vehicle(simulation));
  const FramePair pair = test::require_ok(vehicle.frame(0, 0, RigidTransform::Identity()));
  const auto estimator = test::require_ok(make_stereo_depth(vehicle.camera, vehicle.baseline_m));
  for (auto _ : state) benchmark::DoNotOptimize(test::require_ok(estimator->estimate(pair)));
}

void search_of_six(benchmark::State& state) {
  const auto all = test::pointers(frames());
  int evaluations = 0;
  for (auto _ : state)
    evaluations =
        test::require_ok(search(Frames(all).first(fitted), drive().T_camera_lidar(), Method::standard)).evaluations;
  state.counters["evaluations"] = evaluations;
}

void search_of_any_orientation(benchmark::State& state) {
  std::vector<FeatureSet> uncut;
  for (int i = 0; i < fitted; ++i)
    uncut.push_back(test::require_ok(make_features(drive().pair(i), drive().depth(i), drive().camera(),
                                                   drive().T_camera_lidar(), {.bounds = {.rotation_rad = 3}})));
  const auto all = test::pointers(uncut);
  const SearchSettings settings{
      .bounds = {}, .any_orientation = true, .free_axes = {true, true, true, false, false, false}};
  const RigidTransform T_start = drive().T_camera_lidar() * test::knock(100, 40, -130);
  RigidTransform found;
  for (auto _ : state) found = test::require_ok(search(all, T_start, Method::standard, settings)).T_camera_lidar;
  state.counters["error_deg"] = rotation_angle_rad(found.inverse() * drive().T_camera_lidar()) / radians_per_degree;
}

void recalibration(benchmark::State& state) {
  const auto all = test::pointers(frames());
  const Frames fit = Frames(all).first(fitted), held = Frames(all).last(held_back);
  int evaluations = 0;
  for (auto _ : state) evaluations = test::require_ok(recalibrate(fit, held, drive().T_camera_lidar(), {})).evaluations;
  state.counters["evaluations"] = evaluations;
  std::size_t bytes = 0;
  for (const FeatureSet& frame : frames()) bytes += frame.memory_bytes();
  state.counters["bytes_kept"] = static_cast<double>(bytes);
}

BENCHMARK(memory_floor)->Unit(benchmark::kMicrosecond);
BENCHMARK(score_of_a_frame)->Arg(8)->Arg(4)->Unit(benchmark::kMicrosecond);
BENCHMARK(stencil_of_a_frame)->Unit(benchmark::kMillisecond);
BENCHMARK(features_of_a_pair)->Unit(benchmark::kMillisecond);
BENCHMARK(stereo_depth_of_a_pair)->Unit(benchmark::kMillisecond);
BENCHMARK(search_of_six)->Unit(benchmark::kMillisecond)->Iterations(1)->Repetitions(3);
BENCHMARK(search_of_any_orientation)->Unit(benchmark::kMillisecond)->Iterations(1)->Repetitions(3);
BENCHMARK(recalibration)->Unit(benchmark::kMillisecond)->Iterations(1)->Repetitions(3);

}  // namespace

BENCHMARK_MAIN();
