#pragma once

#include <functional>
#include <map>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "calib/depth.hpp"
#include "calib/recalibrate.hpp"
#include "clock.hpp"
#include "config.hpp"
#include "drift_alert.hpp"
#include "journal.hpp"
#include "pair_history.hpp"
#include "pair_state.hpp"

namespace calib {

// The life of a camera-LiDAR pair as values and pure functions: no DDS, no clock, no store. `measure` turns samples
// into a measurement, `decide` turns a measurement, its absence or a request into what shall happen. `Service` makes it
// happen.

/// What the configuration says of a pair, as the pipeline needs it.
struct PairSettings {
  std::string vehicle, pair;
  Camera camera;
  /// Pairs that a recalibration is fitted to, at least 8; a quarter as many more are held back.
  int frames = 25;
  SearchBounds bounds{};
  QualityLimits quality{};
  DriftSettings drift{};
  /// Depth comes from one image, by a network. Its error is the same in all images of a road, which shifts the
  /// optimum's translation by decimetres, on pairs held back too: recalibration then turns the LiDAR only.
  bool monocular_depth = false;
  RecalibrationMode mode = RecalibrationMode::propose;
  std::chrono::nanoseconds min_interval{};
  SamplingConfig sampling{};
  /// Digest of what evidence is measured with: sensors, lens, depth source and software.
  std::string evidence_sha256{};
};
[[nodiscard]] PairSettings pair_settings(const Config& config, const PairConfig& pair, std::string evidence_sha256);

/// What one pair of samples shows at the extrinsic in force.
struct Measurement {
  FeatureSet features;
  Stencil stencil;
  std::optional<Matrix6> sensitivity = {};    // while the baseline is learned
  std::optional<double> previous_score = {};  // during a probation, at the extrinsic before
  /// While there is evidence of drift, now and then: of a search over this pair and those since the onset.
  std::optional<Result<Misalignment>> optimum = {};
  SceneThumbnail thumbnail = {};
  Timestamp image_stamp{};
  std::chrono::nanoseconds received{};  // since boot: when the last of its samples had arrived
};

/// A window of sampling without a measurement.
struct Skip {
  Error error;
  int windows = 1;  // counts as so many windows without evidence
};

// What is asked for, by a person ("uid:1000") or by calibd itself ("calibd").

/// What the search for another extrinsic found, and the stamps of the frames that it was made from.
struct FoundExtrinsic {
  Recalibration result;
  std::vector<Timestamp> frames;
};
/// Takes what `PairPipeline::search` found, if the gates let it pass.
struct Recalibrate {
  std::string asked_by;
  bool dry_run;  // decides, and changes nothing
  Result<FoundExtrinsic> found;
  Comment comment{};
};
/// Puts the proposed extrinsic in force; `proposal` is the record that `PairState::proposed_record` names.
struct Accept {
  std::string asked_by;
  std::optional<CalibrationRecord> proposal;
  Comment comment{};
};
/// Puts an earlier extrinsic in force: that of `target`, one of the pair's records.
struct RollBack {
  std::string asked_by;
  std::optional<CalibrationRecord> target;
  Comment comment{};
};

/// One line for the journal: syslog's priority, message id (message_ids.hpp), text and fields.
struct JournalEntry {
  int priority;
  std::string_view message_id;
  std::string text;
  JournalFields fields{};
};

/// What became of a request.
struct Answer {
  Decision decision = Decision::rejected;  // as the record has it; of a dry run, as it would have been
  bool dry_run = false;
  std::string reason;
  std::optional<std::uint64_t> record{};  // that was written
  std::optional<Recalibration> result{};  // where something was computed
};

/// What shall happen, all of it or nothing: the state, the record and the alert are written in one transaction, and
/// count once that is done. Only then anything is published, logged and answered. Where there is nothing of that, the
/// state is evidence, which counts at once and is written within a minute.
struct PairDecision {
  std::optional<PairState> state;  // nothing: nothing changes
  std::optional<CalibrationRecord> record;
  std::optional<DriftAlert> alert;
  std::vector<JournalEntry> journal;
  /// To a request. Fails with `not_found`, `bad_request`, `not_ready` or `failed`.
  Result<Answer> answer = Answer{};
  /// The evidence calls for a recalibration, now.
  bool recalibration_due = false;

  /// Whether the state has new evidence (or a window without) and nothing else has changed.
  [[nodiscard]] bool is_evidence_only() const { return !record && !alert && journal.empty(); }
};

/// `state` is the pair as it was saved, less evidence that was set aside; it counts until `decision` is written.
struct RestoredPair {
  PairState state;
  PairDecision decision;
  std::optional<JournalEntry> set_aside{};  // to be logged, whether or not anything can be written
};

/// The time, and what the records say, when something is decided.
struct Now {
  Moment time;
  std::string boot_id;
  const PairHistory& history;
  std::uint64_t next_sequence = 1;  // of the record that is written next
  /// Why the head of the chain of records could not be saved; nothing when it was.
  std::optional<std::string> not_written{};
  /// Why no record can be signed; nothing when it can. Then no record is asked for, and `calibrated` is said only
  /// relative to a baseline that is signed.
  std::optional<std::string> signing_refused{};
};

class PairPipeline {
 public:
  /// Windows without evidence after which the last verdict no longer counts.
  static constexpr int windows_to_stale = 2;
  /// A pair without evidence for so long, or for two periods and a window where that is longer, is told of, whatever
  /// its verdict was; but for reasons of the scene.
  static constexpr std::chrono::minutes longest_silence{1};

  explicit PairPipeline(PairSettings settings) : settings_(std::move(settings)) {}

  /// What a start makes of what was saved: the last record's extrinsic, unless the configuration has a new one since
  /// (`T_camera_lidar`), for which an `initial` record is written. Saved evidence is kept if its digest is the present
  /// one, and set aside otherwise. Nothing is claimed before this process has evidence of its own.
  /// `saved` may be `malformed_state`; other errors are passed on.
  [[nodiscard]] Result<RestoredPair> restore(const Result<std::optional<PairState>>& saved,
                                             const RigidTransform& T_camera_lidar, const Now& now) const;

  /// Quality, depth, features, stencil, and where the optimum lies when that is wanted: that takes a second or two.
  /// `keep_going` as of `search`; false leaves the optimum out. Fails with the reason why the pair carries no
  /// information, for `Skip`.
  [[nodiscard]] Result<Measurement> measure(const FramePair& pair, const PairState& state, DepthEstimator& depth,
                                            const std::function<bool()>& keep_going = {}) const;

  /// The search of a recalibration, from the pairs since the onset of drift: it takes seconds to minutes. `keep_going`
  /// is called before each evaluation; false ends it. Fails with `not_ready`, `cancelled`, `search_failed` or
  /// `recalibration_failed`.
  [[nodiscard]] Result<FoundExtrinsic> search(const PairState& state, const std::function<bool()>& keep_going) const;

  /// A window's end: verdict, baseline, end of a probation; and whether a recalibration is due.
  [[nodiscard]] PairDecision decide(const PairState& state, Measurement measurement, const Now& now) const;
  [[nodiscard]] PairDecision decide(const PairState& state, const Skip& skip, const Now& now) const;
  /// A request.
  [[nodiscard]] PairDecision decide(const PairState& state, const Recalibrate& request, const Now& now) const;
  [[nodiscard]] PairDecision decide(const PairState& state, const Accept& request, const Now& now) const;
  [[nodiscard]] PairDecision decide(const PairState& state, const RollBack& request, const Now& now) const;

  /// What is shown of `state`. `store_failure`: why the last transaction failed. Sensors' inputs and the proposal's
  /// extrinsic are left out.
  [[nodiscard]] PairStatus status(const PairState& state, const std::optional<Error>& store_failure,
                                  const Now& now) const;

  /// The state without evidence that the records do not vouch for.
  [[nodiscard]] PairState without_evidence(PairState state, const Now& now) const {
    set_evidence_aside(state, now);
    return state;
  }

  [[nodiscard]] const PairSettings& settings() const { return settings_; }
  /// Whose features are kept for a recalibration.
  [[nodiscard]] std::size_t frames_to_keep() const { return wanted_frames(); }

 private:
  [[nodiscard]] DriftMonitor monitor(const PairState& state) const {
    return DriftMonitor(settings_.drift, state.drift);
  }
  void set_evidence_aside(PairState& state, const Now& now) const;
  void tell_new_extrinsic(PairDecision& decision, Verdict before, const Now& now) const;
  [[nodiscard]] CalibrationRecord new_record(Decision decision, const PairState& state, std::string asked_by,
                                             std::string reason) const;

  // pair_optimum.cpp
  [[nodiscard]] std::optional<Result<Misalignment>> find_optimum(const PairState& state, const Measurement& latest,
                                                                 const std::function<bool()>& keep_going) const;
  [[nodiscard]] std::optional<Misalignment> found_misalignment(const PairState& state) const;
  [[nodiscard]] std::optional<Misalignment> misalignment(const PairState& state) const;

  // pair_decide.cpp
  [[nodiscard]] bool shows_same_scene(const PairState& state, const Measurement& measurement) const;
  [[nodiscard]] PairDecision conclude(const PairState& before, PairState after, const Now& now) const;
  void conclude_verdict(PairState& after, const Now& now) const;
  [[nodiscard]] std::optional<Error> unvouched(const Now& now) const;
  [[nodiscard]] std::optional<CalibrationRecord> baseline_due(const PairState& state, const Now& now) const;
  void tell_absence(PairDecision& decision, const Now& now) const;
  [[nodiscard]] DriftAlert alert(const PairState& before, const PairState& after, const Now& now) const;
  [[nodiscard]] JournalFields fields(const PairState& after, std::uint64_t record) const;
  void finish(PairDecision& decision, const PairState& before, const PairState& evidence, const Now& now) const;
  [[nodiscard]] std::optional<Grounds> grounds(const PairState& state, std::optional<std::string> not_written) const;

  // pair_recalibrate.cpp
  [[nodiscard]] std::size_t wanted_frames() const;
  [[nodiscard]] std::vector<const FeatureSet*> eligible_frames(const PairState& state) const;
  [[nodiscard]] std::string progress(const PairState& state) const;
  [[nodiscard]] std::chrono::nanoseconds wait_after_refusals(const PairState& state) const;
  [[nodiscard]] bool may_recalibrate(const PairState& state, const Now& now) const;
  [[nodiscard]] std::string next_try(const PairState& state, const Now& now) const;
  void count_refusal(PairState& state) const;
  [[nodiscard]] RecalibrationSettings recalibration_settings(const PairState& state) const;

  // pair_in_force.cpp
  [[nodiscard]] PairDecision put_in_force(CalibrationRecord record, const PairState& before, PairState after,
                                          const Now& now) const;
  [[nodiscard]] PairDecision end_probation(const PairState& before, PairState after, const std::string& why,
                                           const Now& now) const;

  PairSettings settings_;
};

/// The verdict that evidence alone carries.
[[nodiscard]] Verdict shown(DriftVerdict verdict);

}  // namespace calib
