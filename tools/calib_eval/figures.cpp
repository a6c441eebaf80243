#include "calib_eval/figures.hpp"

#include <fmt/format.h>

#include <cmath>

#include "calib/overlay.hpp"

namespace calib::eval {
namespace {

/// The pixel of the frame's grid that a point lands on, rounded to the nearest as scores do.
std::optional<std::size_t> pixel_of(const BearingGrid& grid, const Eigen::Vector3d& p_camera) {
  const double denominator = p_camera.z() + (grid.xi != 0 ? grid.xi * p_camera.norm() : 0);
  if (denominator <= 1e-6) return std::nullopt;
  const double u = std::floor(grid.fx * p_camera.x() / denominator + grid.cx + 0.5);
  const double v = std::floor(grid.fy * p_camera.y() / denominator + grid.cy + 0.5);
  if (!(u >= 0 && u < grid.width && v >= 0 && v < grid.height)) return std::nullopt;
  return static_cast<std::size_t>(v) * grid.width + static_cast<std::size_t>(u);
}

Features features_of(const Objective& objective) {
  const FeaturePair first = objective.terms[0].features;
  return first == FeaturePair::intensity || first == FeaturePair::linear_intensity ? Features::intensity
                                                                                   : Features::depth;
}

}  // namespace

JointHistogram joint_histogram(const FeatureSet& frame, const RigidTransform& T_camera_lidar, Features features) {
  constexpr int ranks_per_class = FeatureSet::ranks / JointHistogram::classes;
  const bool of_depth = features == Features::depth;
  const auto& points = of_depth ? frame.range_rank : frame.reflectance_rank;
  const auto& pixels = frame.planes->packed;
  const PackedClass& where = of_depth ? FeaturePlanes::depth : FeaturePlanes::grey;
  JointHistogram histogram;
  if (points.empty() || pixels.empty()) return histogram;
  for (std::size_t i = 0; i < frame.points(); ++i) {
    const auto pixel = pixel_of(frame.planes->grid, T_camera_lidar * frame.point(i).cast<double>());
    if (!pixel || points[i] >= FeatureSet::ranks || where.rank(pixels[*pixel]) >= FeatureSet::ranks) continue;
    ++histogram
          .counts[points[i] / ranks_per_class * JointHistogram::classes + where.rank(pixels[*pixel]) / ranks_per_class];
  }
  return histogram;
}

Result<std::optional<Figure>> draw(const RecordingFrames& recording_frames, const Experiment& experiment,
                                   const std::filesystem::path& folder) {
  const Cell& cell = experiment.cell;
  Figure figure;
  figure.run = experiment.runs.size() / 2;
  const Run& run = experiment.runs[figure.run];
  if (!run.result) return std::nullopt;
  const RecordingFrames::Frame& frame = recording_frames.frames[recording_frames.frames.size() / 2];
  const auto features = make_features(frame.pair, frame.depth, recording_frames.camera, recording_frames.T_camera_lidar,
                                      {.bounds = reach(cell.range), .baselines = needs_baseline_features(cell.method)});
  if (!features) return propagate(features);
  const Objective& objective = run.result->objective;
  figure.features = features_of(objective);

  figure.frame = frame.name;
  const std::string stem = fmt::format("{}_{}dof_{:g}deg_{:g}cm_", to_string(cell.method), cell.degrees_of_freedom,
                                       cell.range.rotation_deg, cell.range.translation_cm);
  const struct {
    const char* name;
    RigidTransform motion;
  } views[] = {{"start", run.start}, {"end", run.end}, {"truth", RigidTransform::Identity()}};
  for (const auto& [name, motion] : views) {
    const RigidTransform T_camera_lidar = recording_frames.T_camera_lidar * motion;
    const auto file = folder / (std::string(stem) + name + ".png");
    if (auto written = write_overlay(file, frame.pair, recording_frames.camera, T_camera_lidar); !written)
      return propagate(written);
    figure.views.push_back({name, score(*features, T_camera_lidar, objective).value,
                            joint_histogram(*features, T_camera_lidar, figure.features), file});
  }
  return figure;
}

}  // namespace calib::eval
