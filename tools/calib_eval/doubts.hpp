#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "calib_eval/experiment.hpp"

namespace calib::eval {

/// A reason for not believing a result. `code` is stable, `words` is a sentence without its full stop.
struct Doubt {
  std::string_view code;
  std::string words;

  bool operator==(const Doubt&) const = default;
};
using Doubts = std::vector<Doubt>;

/// Every code that a doubt may have.
namespace doubt {
inline constexpr std::string_view few_frames = "few_frames";
inline constexpr std::string_view low_agreement = "low_agreement";
inline constexpr std::string_view layout_in_doubt = "layout_in_doubt";
inline constexpr std::string_view extrinsic_suspect = "extrinsic_suspect";
inline constexpr std::string_view pairing_suspect = "pairing_suspect";
inline constexpr std::string_view search_failures = "search_failures";
inline constexpr std::string_view not_repeatable = "not_repeatable";
inline constexpr std::string_view unlike_recording = "unlike_recording";
inline constexpr std::string_view axis_at_limit = "axis_at_limit";
inline constexpr std::string_view axis_not_observable = "axis_not_observable";
}  // namespace doubt

/// What is doubtful about the frames, whatever is computed from them:
/// - `few_frames`: fewer than ten. calibd recalibrates from no fewer either (`recalibration.frames` is 8 or more, and a
///   quarter more is held back).
/// - `low_agreement`: at the recording's extrinsic depth does not grow with range (rank correlation below 0.5).
/// - `layout_in_doubt`: the reader of a cloud has remarked on its layout.
/// - `extrinsic_suspect`: another reading of the recording's extrinsic goes better with the depth.
/// - `pairing_suspect`: see `PairingContrast`.
[[nodiscard]] Doubts doubts_of(const RecordingFrames& recording_frames);

/// What is doubtful about where the searches of a cell end:
/// - `search_failures`: some did not end at all.
/// - `not_repeatable`: fewer than half end where the one with the best score does, within 0.5 degrees and 20 cm; or
///   there is one search only.
/// - `unlike_recording`: fewer than half end at the recording's extrinsic.
/// - `axis_at_limit`, `axis_not_observable`: of the best one.
/// - `low_agreement`: there depth does not grow with range.
[[nodiscard]] Doubts doubts_of(const Experiment& experiment);
[[nodiscard]] Doubts doubts_of(const Experiment& experiment, const RecordingFrames& recording_frames);

/// Whether the depth of frames goes with their own clouds, or with those so many frames later. Rank correlations of all
/// depths with all clouds are compared after the mean of each depth and of each cloud is taken off, because some depths
/// and some clouds agree better with any. Of at most 16 frames in a row, from the middle of the recording.
///
/// Frames of one scene, or depth that is too coarse, show nothing: on recorded frames the own clouds stand out by 8.7
/// (stereo) and 3.8 (a network), others by less than 2; in slow traffic all neighbours do. Clouds of another drive do
/// not show either.
struct PairingContrast {
  std::size_t frames = 0;
  /// By how many standard errors the clouds of a shift agree better than any: without one, and of the best.
  double own = 0, best = 0;
  std::size_t best_shift = 0;

  [[nodiscard]] bool can_tell() const { return frames >= 8 && best >= 3.5; }
  [[nodiscard]] bool suspect() const { return can_tell() && best - own >= 3; }
};
[[nodiscard]] PairingContrast pairing_contrast(const RecordingFrames& recording_frames);

/// Codes in the order in which they appear, each once, with commas. Empty without a doubt.
[[nodiscard]] std::string codes_of(const Doubts& doubts);

}  // namespace calib::eval
