#pragma once

#include <array>
#include <cstddef>
#include <span>
#include <string_view>
#include <vector>

#include "calib/features.hpp"

namespace calib {

/// Two features of a frame whose joint histogram is taken: one of the points, one of the pixels that they project to.
enum class FeaturePair {
  depth,             // rank of the distance, rank of depth
  tiled_depth,       // rank of the distance, rank of depth among its tile of the image: one histogram per tile
  intensity,         // rank of reflectance, rank of brightness
  fine_intensity,    // the same, for more than 30 classes
  linear_depth,      // range, depth, as the paper has them
  linear_intensity,  // reflectance, brightness, as the paper's baseline has them
  edges              // jumps of range, contrast of brightness; no histogram: see `Term`
};

/// One term of an objective. That of `edges` is 1/2 and the mean rank of contrast, 0 to 1, where the LiDAR sees the
/// outline of something: 1 on the average over an image, as the others are of independent features.
struct Term {
  FeaturePair features = FeaturePair::depth;
  double weight = 1;  // positive
  /// A power of two up to 16: 1, 4, 8 or 16 make 240, 60, 30 or 15 classes. More classes give a sharper optimum, fewer
  /// a wider basin. At least 4 with `depth`, 8 with `tiled_depth` and `intensity`.
  int ranks_per_class = 4;
  /// Normalised mutual information (H(X) + H(Y)) / H(X, Y), after Studholme 1999, of a joint histogram smoothed with
  /// [1 2 1] / 4 in both directions: 1 for independent features, at most 2. It is the one that a change of overlap
  /// moves least. Otherwise the paper's H(X) + H(Y) - H(X, Y) in nats (Eq. "MI"), as it is.
  bool normalised = true;
};

/// What is maximised: the weighted mean of one to four terms.
struct Objective {
  static constexpr std::size_t most_terms = 4;
  std::array<Term, most_terms> terms{};
  int count = 1;
  /// Scores an even sample of one in `stride` points, a power of two up to 32; for coarse searches.
  int stride = 1;

  [[nodiscard]] std::span<const Term> all() const { return {terms.data(), static_cast<std::size_t>(count)}; }
};

/// Depth alone.
inline constexpr Objective depth_objective{};

struct Score {
  double value = 0;
  /// Points that project to a pixel with a value, in the first term.
  std::size_t points = 0;
};

/// The score of one frame at an extrinsic. The frame has planes. A term with fewer than `min_scored_points` points, or
/// whose features the frame does not have, carries no information: 1 when it is normalised, else 0. Tiles are weighted
/// by their points. Deterministic for a given processor; processors with other vector units differ in the last bits of
/// a pixel's coordinates, which changes a frame's score by less than 1e-3.
[[nodiscard]] Score score(const FeatureSet& features, const RigidTransform& T_camera_lidar,
                          const Objective& objective = depth_objective);
inline constexpr std::size_t min_scored_points = 200;
/// Likewise of `edges`, of which a scan has a twentieth as many; from twice as many on they count in full.
inline constexpr std::size_t min_scored_edges = 100;

/// Frames that are stored elsewhere; none is null.
using Frames = std::span<const FeatureSet* const>;

/// The mean score over frames (paper, Eq. "MI average"; pooling the histograms instead is measurably worse).
/// Points are summed.
[[nodiscard]] Score mean_score(Frames frames, const RigidTransform& T_camera_lidar,
                               const Objective& objective = depth_objective);

/// The same at several extrinsics, frame by frame: the memory that a frame's scores read stays in the processor's
/// caches, which a mean over many frames exceeds.
[[nodiscard]] std::vector<Score> mean_scores(Frames frames, std::span<const RigidTransform> T_camera_lidar,
                                             const Objective& objective = depth_objective);

/// Name of the vector instructions that scores are computed with on this processor.
[[nodiscard]] std::string_view vector_instructions();

}  // namespace calib
