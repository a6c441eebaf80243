#pragma once

#include <array>
#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <string_view>

#include "calib/drift.hpp"
#include "calib/quality.hpp"
#include "calib/record.hpp"
#include "calib/status.hpp"

namespace calib {

/// How an extrinsic that was accepted does against the one that it replaced, on pairs taken since: running moments
/// (Welford 1962) of the gain in score, pair by pair.
struct Probation {
  int pairs = 0;
  double gain = 0, gain_squares = 0;  // mean, sum of squared deviations

  void add(double pair_gain);
  /// Of `gain`; infinite below two pairs.
  [[nodiscard]] double standard_error() const;
  /// Whether the gain is more than `sigmas` standard errors above zero; negative: below.
  [[nodiscard]] bool exceeds(double sigmas) const;
};

/// What this process has seen of a pair at the extrinsic in force. Not saved.
struct PairRun {
  std::uint64_t pairs = 0;
  /// When the samples of the last one had been received.
  BootTime received;
  /// Features of the latest pairs, oldest first: what a recalibration is computed from.
  std::deque<std::shared_ptr<const FeatureSet>> frames;
  std::optional<SceneThumbnail> last_image;
  /// Of the pair that was evidence last but for those of its own scene.
  std::optional<SceneThumbnail> scene;
  /// While there is evidence of drift: where the latest search over pairs since its onset found the optimum, if it did,
  /// and `PairState::evaluated` at that search.
  std::optional<Misalignment> optimum;
  std::optional<std::uint64_t> searched_at;
  /// Windows in turn without evidence, and why the last of them had none.
  int windows_without_evidence = 0;
  std::optional<Error> last_skip;
  /// Time since boot of the first of them, and whether it was told that they last.
  std::optional<std::chrono::nanoseconds> without_evidence_since;
  bool absence_told = false;
  /// When the last window ended (time since boot), and how long the last two cycles took, the latest first.
  std::optional<std::chrono::nanoseconds> last_window;
  std::array<std::chrono::nanoseconds, 2> cycles{};
};

/// What is known of a pair. The extrinsics come from the records, and `run` ends with the process; all else is saved.
struct PairState {
  DriftState drift;
  /// Digest of what `drift` was measured with; empty while there is none.
  std::string evidence_sha256;
  Verdict verdict = Verdict::not_evaluated;
  std::optional<ErrorCode> cause = ErrorCode::no_pair_yet;  // as of `Claim`
  std::string reason = "no pair was evaluated yet";
  /// Why the extrinsic in force must not be called calibrated whatever is learned at it; nothing when it may. Ends when
  /// an extrinsic is put in force.
  std::optional<std::string> unresolved;
  WallTime since{};
  std::optional<WallTime> last_evaluated;
  std::uint64_t evaluated = 0;
  std::map<std::string, std::uint64_t> skipped;
  std::optional<PairStatus::Score> score;
  /// Stamp of the last evaluated image: the same one is not evidence twice.
  Timestamp last_stamp{};
  /// The record of a proposal that waits for an answer.
  std::optional<std::uint64_t> proposed_record;
  /// While the extrinsic in force is on probation.
  std::optional<Probation> probation;
  /// Recalibrations in turn that were rejected, or did not pass their probation. Each doubles the pairs and the time
  /// until calibd tries again by itself: pairs until `evaluated` is `retry_at`, time since `recalibrated`.
  int refusals = 0;
  std::uint64_t retry_at = 0;
  std::optional<WallTime> recalibrated;

  [[nodiscard]] Claim claimed() const { return {verdict, cause, reason}; }
  void set(Claim claim) {
    verdict = claim.verdict;
    cause = claim.cause;
    reason = std::move(claim.reason);
  }

  void put_in_force(const CalibrationRecord& record) {
    T_camera_lidar = record.T_camera_lidar;
    T_camera_lidar_before = record.T_camera_lidar_before;
  }

  /// The extrinsic in force and the one that it replaced, as its record has them.
  RigidTransform T_camera_lidar = RigidTransform::Identity(), T_camera_lidar_before = RigidTransform::Identity();
  PairRun run;
};

/// What is saved of `state`.
[[nodiscard]] std::string to_text(const PairState& state);
/// Its inverse. Fails with `malformed_state`: the daemon then begins anew for this pair, and says so.
[[nodiscard]] Result<PairState> parse_pair_state(std::string_view text);

}  // namespace calib
