#include "calib_eval/experiment.hpp"

#include <ctime>

#include "calib_eval/parallel.hpp"

namespace calib::eval {
namespace {

/// Time that this thread has had a core: other programs on the machine do not count.
double thread_seconds() {
  timespec now{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
  return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
}

SearchSettings settings_for(const Cell& cell) {
  return {.bounds = search_bounds(cell.range),
          .any_orientation = cell.range.any_orientation(),
          .free_axes = cell.free_axes(),
          .monocular_depth = cell.monocular_depth};
}

Spread spread_of(const std::vector<Vector6>& values) {
  if (values.empty()) return {};
  Vector6 mean = Vector6::Zero(), squares = Vector6::Zero();
  for (const Vector6& value : values) mean += value;
  mean /= static_cast<double>(values.size());
  if (values.size() == 1) return {mean, std::nullopt};
  for (const Vector6& value : values) squares += (value - mean).cwiseAbs2();
  return {mean, (squares / static_cast<double>(values.size() - 1)).cwiseSqrt()};
}

std::optional<Best> best_of(const std::vector<Run>& runs, Frames frames, const Cell& cell) {
  // Scores of different objectives cannot be compared, and that depends on whether a run found the depth biased.
  std::ptrdiff_t votes = 0;
  for (const Run& run : runs)
    if (run.result) votes += run.result->depth_is_biased ? 1 : -1;
  std::optional<std::size_t> best;
  for (std::size_t i = 0; i < runs.size(); ++i) {
    if (!runs[i].result || runs[i].result->depth_is_biased != (votes > 0)) continue;
    if (!best || runs[i].result->score_after > runs[*best].result->score_after) best = i;
  }
  if (!best) return std::nullopt;
  const SearchResult& result = *runs[*best].result;
  return Best{*best, uncertainty(frames, result.T_camera_lidar, result.objective, settings_for(cell))};
}

}  // namespace

Vector6 in_degrees_and_cm(const Vector6& delta) {
  Vector6 shown;
  shown << delta.head<3>() / radians_per_degree, delta.tail<3>() * 100;
  return shown;
}

Summary summarise(const std::vector<Run>& runs) {
  Summary summary;
  std::vector<Vector6> of_hits, of_all;
  double rotation_deg = 0, translation_cm = 0, evaluations = 0, seconds = 0;
  for (const Run& run : runs) {
    ++summary.starts;
    if (!run.result) {
      ++summary.failures;
      continue;
    }
    evaluations += run.result->evaluations;
    seconds += run.seconds;
    of_all.push_back(in_degrees_and_cm(perturbation_parameters(run.end)));
    if (!run.hit()) continue;
    ++summary.hits;
    of_hits.push_back(of_all.back());
    rotation_deg += run.rotation_error_rad() / radians_per_degree;
    translation_cm += run.translation_error_m() * 100;
  }
  if (summary.hits > 0) {
    summary.hit_rotation_error_deg = rotation_deg / summary.hits;
    summary.hit_translation_error_cm = translation_cm / summary.hits;
  }
  if (!of_all.empty()) {
    summary.evaluations = evaluations / static_cast<double>(of_all.size());
    summary.seconds_per_run = seconds / static_cast<double>(of_all.size());
  }
  summary.of_hits = spread_of(of_hits);
  summary.of_all = spread_of(of_all);
  return summary;
}

Result<Experiment> conduct(const RecordingFrames& recording_frames, const Cell& cell, const Protocol& protocol) {
  const auto features = recording_frames.features(
      {.bounds = reach(cell.range), .baselines = needs_baseline_features(cell.method)}, protocol.threads);
  if (!features) return propagate(features);
  const auto frames = pointers(*features);
  const auto starts = starting_motions(cell.range, cell.degrees_of_freedom == 6, protocol.starts, protocol.seed);

  Experiment experiment{cell, std::vector<Run>(starts.size()), std::nullopt};
  parallel_for(starts.size(), protocol.threads, [&](std::size_t i) {
    Run& run = experiment.runs[i];
    run.start = starts[i];
    const double began = thread_seconds();
    run.result = search(frames, recording_frames.T_camera_lidar * run.start, cell.method, settings_for(cell));
    run.seconds = thread_seconds() - began;
    if (run.result) run.end = recording_frames.T_camera_lidar.inverse() * run.result->T_camera_lidar;
    protocol.run_done();
  });
  experiment.best = best_of(experiment.runs, frames, cell);
  return experiment;
}

}  // namespace calib::eval
