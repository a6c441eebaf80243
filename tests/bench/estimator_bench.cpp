#include <benchmark/benchmark.h>
#include <hwy/targets.h>

#include <algorithm>
#include <chrono>
#include <string>

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

/// Shortest time of a point, in seconds, in the loop that a score cannot do without: read coordinates (as floats) and
/// rank, read one pixel, increment one count. Measured beside what is measured next.
double floor_of_a_point() {
  using Clock = std::chrono::steady_clock;
  const FeatureSet& frame = frames().front();
  const std::size_t pixels_per_point = frame.planes->packed.size() / frame.points();
  const std::vector<float> x(frame.x.begin(), frame.x.end()), y(frame.y.begin(), frame.y.end()),
      z(frame.z.begin(), frame.z.end());
  std::vector<std::uint32_t> counts(64 * 64);
  Clock::duration shortest = Clock::duration::max();
  for (int repetition = 0; repetition < 100; ++repetition) {
    const auto begin = Clock::now();
    for (std::size_t i = 0; i < frame.points(); ++i) {
      const std::uint16_t pixel = frame.planes->packed[i * pixels_per_point];
      counts[frame.range_rank[i] / 4 * 64 + (pixel & 63)] += x[i] + y[i] + z[i] > -1e6F;
    }
    benchmark::ClobberMemory();
    shortest = std::min(shortest, Clock::now() - begin);
  }
  return std::chrono::duration<double>(shortest).count() / static_cast<double>(frame.points());
}

/// Counters of a benchmark whose iteration projects `points`: the time of one, and how many times the floor it is.
void compare_with_floor(benchmark::State& state, std::size_t points, double floor) {
  const auto time_over = benchmark::Counter::kIsIterationInvariantRate | benchmark::Counter::kInvert;
  const auto count = static_cast<double>(points);
  state.counters["point"] = benchmark::Counter(count, time_over);
  state.counters["floors"] = benchmark::Counter(count * floor, time_over);
}

void score_of_a_frame(benchmark::State& state, const Objective& objective) {
  const FeatureSet& frame = frames().front();
  const double floor = floor_of_a_point();
  for (auto _ : state) benchmark::DoNotOptimize(score(frame, drive().T_camera_lidar(), objective));
  compare_with_floor(state, frame.points(), floor);
}

void score_of_one_term(benchmark::State& state) { score_of_a_frame(state, depth_objective); }

void score_of_four_terms(benchmark::State& state) {
  score_of_a_frame(state, final_objective(Method::standard, {true, true, true, true, true, true}));
}

void stencil_of_a_frame(benchmark::State& state) {
  const FeatureSet& frame = frames().front();
  const double floor = floor_of_a_point();
  for (auto _ : state) benchmark::DoNotOptimize(evaluate_stencil(frame, drive().T_camera_lidar()));
  compare_with_floor(state, 13 * frame.points(), floor);
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

using Run = void (*)(benchmark::State&);

/// Registers a benchmark once for each set of vector instructions that this processor has.
void for_each_target(const std::string& name, Run run, benchmark::TimeUnit unit, int repetitions = 0) {
  for (const std::int64_t target : hwy::SupportedAndGeneratedTargets()) {
    hwy::SetSupportedTargetsForTest(target);
    const std::string full_name = name + "/" + std::string(vector_instructions());
    auto* benchmark = benchmark::RegisterBenchmark(full_name.c_str(), [run, target](benchmark::State& state) {
      hwy::SetSupportedTargetsForTest(target);
      run(state);
      hwy::SetSupportedTargetsForTest(0);
    });
    benchmark->Unit(unit);
    if (repetitions > 0) benchmark->Iterations(1)->Repetitions(repetitions)->ReportAggregatesOnly();
  }
  hwy::SetSupportedTargetsForTest(0);
}

}  // namespace

int main(int argc, char** argv) {
  benchmark::AddCustomContext("production_runs_with", std::string(vector_instructions()));
  for_each_target("score_of_one_term", score_of_one_term, benchmark::kMicrosecond);
  for_each_target("score_of_four_terms", score_of_four_terms, benchmark::kMicrosecond);
  for_each_target("stencil_of_a_frame", stencil_of_a_frame, benchmark::kMicrosecond);
  for_each_target("search_of_six", search_of_six, benchmark::kMillisecond, 3);
  for_each_target("search_of_any_orientation", search_of_any_orientation, benchmark::kMillisecond, 3);
  for_each_target("recalibration", recalibration, benchmark::kMillisecond, 3);
  benchmark::RegisterBenchmark("features_of_a_pair", features_of_a_pair)->Unit(benchmark::kMillisecond);
  benchmark::RegisterBenchmark("stereo_depth_of_a_pair", stereo_depth_of_a_pair)->Unit(benchmark::kMillisecond);
  benchmark::Initialize(&argc, argv);
  if (benchmark::ReportUnrecognizedArguments(argc, argv)) return 1;
  benchmark::RunSpecifiedBenchmarks();
  benchmark::Shutdown();
}
