#include "calib_eval/drift_estimate.hpp"

#include <algorithm>

#include "calib_eval/parallel.hpp"
#include "vehicle/random.hpp"

namespace calib::eval {
namespace {

constexpr std::uint64_t estimate_frames = 3;  // after the purposes of drift_sequences.cpp

std::vector<const FeatureSet*> drawn(const std::vector<FeatureSet>& features, const SequenceSettings& settings,
                                     std::size_t number) {
  FrameDraw draw(features.size(), settings.block, vehicle::mix(settings.seed, estimate_frames, number));
  std::vector<const FeatureSet*> frames;
  while (frames.size() < std::min(frames_per_estimate, features.size()))
    if (const FeatureSet* frame = &features[draw.next()]; std::ranges::find(frames, frame) == frames.end())
      frames.push_back(frame);
  return frames;
}

}  // namespace

std::vector<std::optional<Estimate>> estimates_of(const std::vector<FeatureSet>& features,
                                                  const RigidTransform& T_camera_lidar, int axis, double moved,
                                                  bool monocular_depth, const DriftMonitor& monitor,
                                                  const SequenceSettings& settings, std::size_t count) {
  const RigidTransform in_force = T_camera_lidar * perturbation(Vector6::Unit(axis) * moved).inverse();
  const SearchSettings how{.bounds = {}, .monocular_depth = monocular_depth};
  std::vector<std::optional<Estimate>> estimates(count);
  parallel_for(estimates.size(), settings.threads, [&](std::size_t number) {
    const auto found = find_misalignment(drawn(features, settings, number), in_force, how);
    if (!found) return;
    const Misalignment estimate = monitor.with_bias(*found, how.bounds);
    estimates[number] = {estimate.delta[axis] - moved, estimate.sigma()[axis]};
  });
  return estimates;
}

}  // namespace calib::eval
