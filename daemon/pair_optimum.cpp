#include <cmath>

#include "pair_pipeline.hpp"

namespace calib {
namespace {

/// There is a search over the first pairs since the onset that suffice, and then one in so many pairs.
constexpr std::uint64_t pairs_between_searches = 8;

}  // namespace

/// Where the optimum lies, when that is wanted: since the onset while there is evidence of drift, and once of as many
/// pairs as a recalibration takes when the baseline has been learned. A search that finds nothing costs its result.
std::optional<Misalignment> PairPipeline::optimum(const PairState& state, const FeatureSet& latest,
                                                  const std::function<bool()>& keep_going) const {
  std::vector<const FeatureSet*> frames = eligible_frames(state);
  frames.push_back(&latest);
  const bool drift = speaks_of_drift(state.drift.verdict);
  if (!drift && (state.usual_optimum || !monitor(state).learned())) return std::nullopt;
  const std::size_t fewest = drift ? fewest_misalignment_frames : wanted_frames();
  const bool first = drift && !state.run.optimum && frames.size() == fewest;
  if (frames.size() < fewest || (!first && state.run.pairs % pairs_between_searches != 0)) return std::nullopt;
  const auto found = find_misalignment(
      frames, state.T_camera_lidar,
      {.bounds = settings_.bounds, .monocular_depth = settings_.monocular_depth, .keep_going = keep_going});
  return found ? std::optional(*found) : std::nullopt;
}

/// By the search.
std::optional<Misalignment> PairPipeline::found_misalignment(const PairState& state) const {
  if (!state.run.optimum || !speaks_of_drift(state.drift.verdict)) return std::nullopt;
  if (state.usual_optimum) return state.run.optimum->since(*state.usual_optimum);
  // By how much the depth source shifts the optimum is not known.
  Misalignment estimate = *state.run.optimum;
  for (int axis = 0; axis < 6; ++axis) {
    const double bias = axis < 3 ? settings_.drift.max_bias_rotation_rad : settings_.drift.max_bias_translation_m;
    const double bound = axis < 3 ? settings_.bounds.rotation_rad : settings_.bounds.translation_m;
    estimate.covariance(axis, axis) += std::pow(std::min(bias, bound), 2);
  }
  return estimate;
}

/// By the search, before that by the slopes. Nothing where they only tell that the LiDAR has moved far.
std::optional<Misalignment> PairPipeline::misalignment(const PairState& state) const {
  if (auto found = found_misalignment(state)) return found;
  const DriftMonitor drift = monitor(state);
  if (speaks_of_drift(drift.verdict()) && drift.maximum_is_lost()) return std::nullopt;
  return drift.misalignment();
}

}  // namespace calib
