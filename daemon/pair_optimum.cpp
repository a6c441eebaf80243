#include "pair_pipeline.hpp"

namespace calib {
namespace {

/// A search uses the latest pairs since the onset, as soon as they suffice, and then once in so many pairs.
constexpr std::size_t most_frames = 12;
constexpr std::uint64_t pairs_between_searches = 8;

}  // namespace

/// Nothing when there is no search now, or when it was ended. What it throws costs the search and no more.
std::optional<Result<Misalignment>> PairPipeline::find_optimum(const PairState& state, const Measurement& latest,
                                                               const std::function<bool()>& keep_going) const try {
  if (!speaks_of_drift(state.drift.verdict)) return std::nullopt;
  if (state.run.searched_at && state.evaluated < *state.run.searched_at + pairs_between_searches) return std::nullopt;
  std::vector<const FeatureSet*> frames = eligible_frames(state);
  if (!frames.empty() && shows_same_scene(state, latest)) frames.pop_back();  // it gives way to this one
  frames.push_back(&latest.features);
  if (frames.size() < fewest_misalignment_frames) return std::nullopt;
  if (frames.size() > most_frames) frames.erase(frames.begin(), frames.end() - most_frames);
  auto found = find_misalignment(
      frames, state.T_camera_lidar,
      {.bounds = settings_.bounds, .monocular_depth = settings_.monocular_depth, .keep_going = keep_going});
  if (!found && found.error().code == ErrorCode::cancelled) return std::nullopt;
  return found;
} catch (const std::exception& exception) {
  return fail(ErrorCode::search_failed, std::string("the search was broken off: ") + exception.what());
}

std::optional<Misalignment> PairPipeline::found_misalignment(const PairState& state) const {
  if (!state.run.optimum) return std::nullopt;
  return monitor(state).with_bias(*state.run.optimum, settings_.bounds);
}

/// By the search, before that by the slopes. Nothing where they only tell that the LiDAR has moved far.
std::optional<Misalignment> PairPipeline::misalignment(const PairState& state) const {
  if (auto found = found_misalignment(state)) return found;
  const DriftMonitor drift = monitor(state);
  if (speaks_of_drift(drift.verdict()) && drift.maximum_is_lost()) return std::nullopt;
  return drift.misalignment();
}

}  // namespace calib
