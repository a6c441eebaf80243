#include "calib_eval/doubts.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "calib/extrinsic_check.hpp"

namespace calib::eval {
namespace {

constexpr std::size_t enough_frames = 10;

/// Of values that are not empty.
double median(std::vector<double> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::ranges::nth_element(values, middle);
  return *middle;
}

void add_low_agreement(const RecordingAgreement& agreement, const std::string& where, Doubts& doubts) {
  if (!agreement.grows_with_range())
    doubts.push_back({doubt::low_agreement,
                      fmt::format("{} the depth does not grow with the LiDAR's range (rank correlation {:.2f}, at "
                                  "least 0.5 where they agree)",
                                  where, agreement.rank_correlation)});
}

/// Median over the frames; nothing where hardly a point projects to depth.
std::optional<RecordingAgreement> agreement_at(const RigidTransform& T_camera_lidar,
                                               const RecordingFrames& recording_frames) {
  std::vector<double> correlations;
  for (const auto& frame : recording_frames.frames)
    if (const auto agreement = depth_agreement(frame.depth, recording_frames.camera, T_camera_lidar, frame.pair.scan))
      correlations.push_back(agreement->rank_correlation);
  if (correlations.empty()) return std::nullopt;
  return RecordingAgreement{.rank_correlation = median(std::move(correlations))};
}

bool is_about_layout(const Error& remark) {
  return remark.code == ErrorCode::cloud_layout || remark.code == ErrorCode::malformed_cloud_layout;
}

void add_layout(const RecordingFrames& recording_frames, Doubts& doubts) {
  for (const auto& frame : recording_frames.frames)
    for (const Error& remark : frame.pair.scan.notes.remarks)
      if (is_about_layout(remark)) {
        doubts.push_back({doubt::layout_in_doubt, "cloud of frame " + frame.name + ": " + remark.context});
        return;
      }
}

void add_extrinsic(const RecordingFrames& recording_frames, Doubts& doubts) {
  const auto& first = recording_frames.frames.front();
  const auto opinion =
      examine_extrinsic(recording_frames.camera, recording_frames.T_camera_lidar, first.pair.scan, &first.depth);
  if (opinion.likely)
    doubts.push_back({doubt::extrinsic_suspect,
                      "the recording's extrinsic does not go with the depth: " + std::string(opinion.likely->words)});
}

/// Whether two searches end at the same extrinsic, by the measure of a hit.
bool same_end(const Run& a, const Run& b) {
  if (!a.result || !b.result) return false;
  const RigidTransform apart = a.end.inverse() * b.end;
  return rotation_angle_rad(apart) < Run::hit_rotation_rad && apart.translation().norm() < Run::hit_translation_m;
}

void add_repeatability(const Experiment& experiment, Doubts& doubts) {
  if (!experiment.best) return;
  if (experiment.runs.size() == 1) {
    doubts.push_back({doubt::not_repeatable, "one search does not show whether others end at the same extrinsic"});
    return;
  }
  const Run& best = experiment.runs[experiment.best->run];
  const auto agreeing = static_cast<std::size_t>(
      std::ranges::count_if(experiment.runs, [&](const Run& run) { return same_end(run, best); }));
  if (2 * agreeing < experiment.runs.size())
    doubts.push_back({doubt::not_repeatable, fmt::format("only {} of {} searches end where the one with the best score "
                                                         "does",
                                                         agreeing, experiment.runs.size())});
}

void add_axes(const Experiment& experiment, Doubts& doubts) {
  if (!experiment.best) return;
  const Run& best = experiment.runs[experiment.best->run];
  if (best.result && best.result->ends_at_limit)
    doubts.push_back({doubt::axis_at_limit, "the search with the best score " + best.result->reason});
  const auto free_axes = experiment.cell.free_axes();
  for (std::size_t i = 0; i < axis_names.size(); ++i)
    if (free_axes[i] && !experiment.best->uncertainty.observable[i])
      doubts.push_back(
          {doubt::axis_not_observable, std::string(axis_names[i]) + " is not observable from these frames"});
}

}  // namespace

PairingContrast pairing_contrast(const RecordingFrames& recording_frames) {
  constexpr std::size_t most = 16;
  const std::size_t all = recording_frames.frames.size(), count = std::min(all, most), first = (all - count) / 2;
  const auto n = static_cast<Eigen::Index>(count);
  PairingContrast contrast{.frames = count};
  Eigen::MatrixXd agreement(n, n);
  for (std::size_t depth = 0; depth < count; ++depth)
    for (std::size_t cloud = 0; cloud < count; ++cloud) {
      const auto of =
          depth_agreement(recording_frames.frames[first + depth].depth, recording_frames.camera,
                          recording_frames.T_camera_lidar, recording_frames.frames[first + cloud].pair.scan);
      if (!of) return {};
      agreement(static_cast<Eigen::Index>(depth), static_cast<Eigen::Index>(cloud)) = of->rank_correlation;
    }
  if (count < 2) return contrast;
  const Eigen::VectorXd of_depths = agreement.rowwise().mean();
  const Eigen::RowVectorXd of_clouds = agreement.colwise().mean();
  const double mean = agreement.mean();
  agreement.colwise() -= of_depths;
  agreement.rowwise() -= of_clouds;
  agreement.array() += mean;
  const double standard_error = std::sqrt(agreement.array().square().mean() / static_cast<double>(count));
  if (!(standard_error > 1e-9)) return contrast;
  for (Eigen::Index shift = 0; shift < n; ++shift) {
    double sum = 0;
    for (Eigen::Index depth = 0; depth < n; ++depth) sum += agreement(depth, (depth + shift) % n);
    const double deviations = sum / static_cast<double>(count) / standard_error;
    if (shift == 0) contrast.own = deviations;
    if (shift == 0 || deviations > contrast.best) {
      contrast.best = deviations;
      contrast.best_shift = static_cast<std::size_t>(shift);
    }
  }
  return contrast;
}

Doubts doubts_of(const RecordingFrames& recording_frames) {
  Doubts doubts;
  const std::size_t count = recording_frames.frames.size();
  if (count < enough_frames)
    doubts.push_back({doubt::few_frames, fmt::format("{} frames are few: {} or more are needed for a result that other "
                                                     "frames would give, too",
                                                     count, enough_frames)});
  if (count == 0) return doubts;
  if (recording_frames.agreement)
    add_low_agreement(*recording_frames.agreement, "at the recording's extrinsic", doubts);
  add_layout(recording_frames, doubts);
  add_extrinsic(recording_frames, doubts);
  const bool agrees = recording_frames.agreement && recording_frames.agreement->grows_with_range();
  if (const PairingContrast contrast = pairing_contrast(recording_frames); agrees && contrast.suspect()) {
    const bool later = 2 * contrast.best_shift <= contrast.frames;
    doubts.push_back(
        {doubt::pairing_suspect,
         fmt::format("the depth of frames agrees better with the clouds of {} frames {} than with their own: "
                     "images and clouds may not belong together",
                     later ? contrast.best_shift : contrast.frames - contrast.best_shift,
                     later ? "later" : "earlier")});
  }
  return doubts;
}

Doubts doubts_of(const Experiment& experiment) {
  Doubts doubts;
  add_axes(experiment, doubts);
  const Summary summary = summarise(experiment.runs);
  const auto failed = std::ranges::find_if(experiment.runs, [](const Run& run) { return !run.result; });
  if (failed != experiment.runs.end())
    doubts.push_back(
        {doubt::search_failures, fmt::format("{} of {} searches failed, the first with: {}", summary.failures,
                                             summary.starts, failed->result.error().context)});
  add_repeatability(experiment, doubts);
  if (summary.starts > 0 && 2 * summary.hits < summary.starts)
    doubts.push_back({doubt::unlike_recording,
                      fmt::format("only {} of {} searches end at the recording's extrinsic: a search over these frames "
                                  "is not to be believed, or that extrinsic is wrong",
                                  summary.hits, summary.starts)});
  return doubts;
}

Doubts doubts_of(const Experiment& experiment, const RecordingFrames& recording_frames) {
  Doubts doubts = doubts_of(experiment);
  if (!experiment.best) return doubts;
  const SearchResult& best = *experiment.runs[experiment.best->run].result;
  if (const auto agreement = agreement_at(best.T_camera_lidar, recording_frames))
    add_low_agreement(*agreement, "where the search with the best score ends", doubts);
  return doubts;
}

std::string codes_of(const Doubts& doubts) {
  std::string codes;
  std::vector<std::string_view> named;
  for (const Doubt& one : doubts) {
    if (std::ranges::find(named, one.code) != named.end()) continue;
    codes += (named.empty() ? "" : ", ") + std::string(one.code);
    named.push_back(one.code);
  }
  return codes;
}

}  // namespace calib::eval
