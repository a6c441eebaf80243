#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "baseline_record.hpp"
#include "message_ids.hpp"
#include "pair_pipeline.hpp"

namespace calib {
namespace {

/// An extrinsic on probation that does worse than the one it replaced is given up early, when that is significant; at
/// the end it has to do better.
constexpr int least_probation_pairs = 5;
constexpr double surely_worse_sigmas = 3, better_sigmas = 2;

/// What a message was refused for was counted message by message.
bool counted_on_arrival(ErrorCode code) {
  return is_malformed(code) || code == ErrorCode::image_size_mismatch || code == ErrorCode::out_of_memory;
}

/// What a drive brings with it, and no fault: night, a tunnel, a parked vehicle.
bool is_of_the_scene(ErrorCode code) {
  switch (code) {
    case ErrorCode::dark:
    case ErrorCode::saturated:
    case ErrorCode::low_texture:
    case ErrorCode::standing_still:
    case ErrorCode::few_valid_depth:
    case ErrorCode::low_overlap:
    case ErrorCode::motion:
      return true;
    default:
      return false;
  }
}

std::string_view message_id(const PairState& state) {
  switch (state.verdict) {
    case Verdict::drifted:
      return message_ids::drifted;
    case Verdict::suspect:
      return message_ids::drift_suspected;
    case Verdict::calibrated:
      return message_ids::cleared;
    case Verdict::not_evaluated:
      break;
  }
  return state.cause == ErrorCode::sensor_silent ? message_ids::sensor_silent : message_ids::not_evaluated;
}

std::string in_words(const Probation& probation) {
  return fmt::format("over {} pairs the score is {:.4f} +/- {:.4f} {} that of the extrinsic before", probation.pairs,
                     std::abs(probation.gain), probation.standard_error(), probation.gain < 0 ? "below" : "above");
}

/// Why evidence carries no verdict; nothing when it carries one.
std::optional<ErrorCode> cause(DriftVerdict verdict) {
  if (shown(verdict) != Verdict::not_evaluated) return std::nullopt;
  return verdict == DriftVerdict::insufficient_power ? ErrorCode::insufficient_power : ErrorCode::learning;
}

void count_cycle(PairRun& run, std::chrono::nanoseconds now) {
  if (run.last_window) run.cycles = {now - *run.last_window, run.cycles[0]};
  run.last_window = now;
}

/// Why an extrinsic has not passed its probation; nothing when it has, or when that is open.
std::optional<std::string> failed_probation(const Probation& probation, bool over) {
  if (probation.pairs < least_probation_pairs) return std::nullopt;
  if (!probation.exceeds(-surely_worse_sigmas) && !(over && !probation.exceeds(better_sigmas))) return std::nullopt;
  return (over ? "not surely better: " : "surely worse: ") + in_words(probation);
}

}  // namespace

PairDecision PairPipeline::decide(const PairState& state, Measurement measurement, const Now& now) const {
  PairState after = state;
  const bool same_scene = shows_same_scene(state, measurement);
  if (after.probation && measurement.previous_score && !same_scene)
    after.probation->add(measurement.stencil.current - *measurement.previous_score);
  AxisEvidence evidence = axis_evidence(measurement.stencil, measurement.features.stamp);
  evidence.sensitivity = measurement.sensitivity;
  evidence.same_scene = same_scene;
  DriftMonitor drift = monitor(after);
  if (const auto observed = drift.observe(evidence); !observed) return decide(state, Skip{observed.error()}, now);
  after.drift = drift.state();
  after.last_evaluated = now.time.wall;
  ++after.evaluated;
  after.last_stamp = measurement.image_stamp;
  const DriftBaseline& baseline = after.drift.baseline;
  after.score = PairStatus::Score{measurement.stencil.current, measurement.stencil.best_neighbour(),
                                  baseline.pairs > 0 ? std::optional(baseline.score) : std::nullopt};
  PairRun& run = after.run;
  if (measurement.optimum) {
    run.optimum = *measurement.optimum ? std::optional(**measurement.optimum) : std::nullopt;
    run.searched_at = after.evaluated;
  }
  if (!speaks_of_drift(after.drift.verdict)) run.optimum.reset(), run.searched_at.reset();
  run.windows_without_evidence = 0;
  run.without_evidence_since.reset();
  run.absence_told = false;
  ++run.pairs;
  run.received = {now.boot_id, measurement.received};
  if (!same_scene) run.scene = measurement.thumbnail;
  run.last_image = std::move(measurement.thumbnail);
  // One frame a scene, the latest: it may have been taken after the onset of drift.
  if (same_scene && !run.frames.empty()) run.frames.pop_back();
  run.frames.push_back(std::make_shared<const FeatureSet>(std::move(measurement.features)));
  if (run.frames.size() > wanted_frames()) run.frames.pop_front();
  return conclude(state, std::move(after), now);
}

PairDecision PairPipeline::decide(const PairState& state, const Skip& skip, const Now& now) const {
  PairState after = state;
  after.run.windows_without_evidence += skip.windows;
  if (!after.run.without_evidence_since) after.run.without_evidence_since = now.time.since_boot;
  after.run.last_skip = Error{skip.error.code, escape_control(skip.error.context)};
  if (!counted_on_arrival(skip.error.code)) ++after.skipped[std::string(to_string(skip.error.code))];
  return conclude(state, std::move(after), now);
}

/// Whether a measurement shows the scene of the latest evidence of this run.
bool PairPipeline::shows_same_scene(const PairState& state, const Measurement& measurement) const {
  return state.run.scene && scene_change(*state.run.scene, measurement.thumbnail) < settings_.drift.min_scene_change;
}

/// From the evidence so far to a verdict, a baseline, the end of a probation, or a recalibration.
PairDecision PairPipeline::conclude(const PairState& before, PairState after, const Now& now) const {
  PairDecision decision;
  count_cycle(after.run, now.time.since_boot);
  // A probation that cannot be ended by a record goes on.
  if (after.probation && after.run.windows_without_evidence == 0 && !now.signing_refused) {
    const bool over = after.probation->pairs >= settings_.drift.baseline_pairs;
    if (const auto why = failed_probation(*after.probation, over))
      return end_probation(before, std::move(after), *why, now);
    if (over) {
      decision.journal.push_back(
          {5, message_ids::probation_passed,
           fmt::format("{}: the extrinsic of record {} has passed its probation: {}", settings_.pair,
                       now.history.in_force()->sequence, in_words(*after.probation)),
           fields(after, now.history.in_force()->sequence)});
      after.probation.reset();
      after.refusals = 0;
    }
  }
  decision.record = baseline_due(after, now);
  conclude_verdict(after, now);
  decision.recalibration_due = after.verdict == Verdict::drifted && !after.proposed_record && !after.probation &&
                               may_recalibrate(after, now) && eligible_frames(after).size() >= wanted_frames();
  decision.state = std::move(after);
  finish(decision, before, *decision.state, now);
  if (decision.record)
    decision.journal.push_back(
        {5, message_ids::baseline_learned,
         fmt::format("{}: {}, record {}", settings_.pair, decision.record->reason, now.next_sequence),
         fields(*decision.state, now.next_sequence)});
  return decision;
}

/// The verdict that the evidence calls for.
void PairPipeline::conclude_verdict(PairState& after, const Now& now) const {
  if (after.run.windows_without_evidence >= windows_to_stale) {
    const Error& skip = *after.run.last_skip;
    after.set({Verdict::not_evaluated, skip.code, fmt::format("{}: {}", to_string(skip.code), skip.context)});
    // Silence heals nothing.
    if (const Verdict last = shown(after.drift.verdict); last == Verdict::drifted || last == Verdict::suspect)
      after.reason += fmt::format("; it was {} when last evaluated", to_string(last));
  } else if (after.run.windows_without_evidence == 0) {
    after.set(
        {shown(after.drift.verdict), cause(after.drift.verdict), monitor(after).reason(found_misalignment(after))});
    if (after.verdict == Verdict::drifted)
      after.reason += "; pairs for recalibration: " + progress(after) + next_try(after, now);
    if (after.probation)
      after.reason += fmt::format("; the extrinsic of record {} is on probation", now.history.in_force()->sequence);
  }
  if (after.unresolved && after.verdict == Verdict::calibrated) {
    after.set(
        {Verdict::not_evaluated, ErrorCode::unresolved,
         fmt::format("unresolved: {}, and what was learned since may be of an extrinsic that is wrong; recalibrate, "
                     "or confirm it with `calibctl rollback {} --to {}`",
                     *after.unresolved, settings_.pair, now.history.in_force()->sequence)});
  }
  if (after.verdict == Verdict::calibrated) {
    if (const auto why = unvouched(now))
      after.set({Verdict::not_evaluated, why->code, fmt::format("{}: {}", to_string(why->code), why->context)});
  }
  // The state itself is about to be written where this changes the verdict.
  after.set(claim(after.claimed(), grounds(after, now.not_written), {now.boot_id, now.time.since_boot}));
}

/// Why the records do not vouch for what `calibrated` would be said of; nothing when they do.
std::optional<Error> PairPipeline::unvouched(const Now& now) const {
  const CalibrationRecord& in_force = *now.history.in_force();
  if (now.history.doubted.contains(in_force.sequence))
    return Error{ErrorCode::unresolved,
                 fmt::format("record {}, which has put the extrinsic in force, is in doubt since its key was revoked; "
                             "recalibrate, or confirm it with `calibctl rollback {} --to {}`",
                             in_force.sequence, settings_.pair, in_force.sequence)};
  if (now.signing_refused && now.history.known_baseline(settings_.evidence_sha256) == nullptr)
    return Error{ErrorCode::wrong_key, "the baseline is not signed: " + *now.signing_refused};
  return std::nullopt;
}

/// The record to sign once the baseline is known, and again whenever it is of ten times as many pairs.
std::optional<CalibrationRecord> PairPipeline::baseline_due(const PairState& state, const Now& now) const {
  if (now.signing_refused) return std::nullopt;
  const DriftBaseline& learned = state.drift.baseline;
  const CalibrationRecord* const last = now.history.known_baseline(settings_.evidence_sha256);
  const int known = last == nullptr ? 0 : static_cast<int>(last->baseline->pairs);
  const int due = std::clamp(10 * known, settings_.drift.baseline_pairs, settings_.drift.max_baseline_pairs);
  if (learned.pairs < due || known >= due) return std::nullopt;
  CalibrationRecord record =
      new_record(Decision::baseline, state, "calibd",
                 fmt::format("the baseline of the extrinsic of record {} was learned from {} pairs",
                             now.history.in_force()->sequence, learned.pairs));
  record.baseline = recorded(learned);
  return record;
}

/// What a change of verdict brings with it: its time, the alert, the journal. `evidence` is what the verdict comes
/// from.
void PairPipeline::finish(PairDecision& decision, const PairState& before, const PairState& evidence,
                          const Now& now) const {
  PairState& after = *decision.state;
  const bool is_absent = after.verdict == Verdict::not_evaluated &&
                         after.run.windows_without_evidence >= windows_to_stale &&
                         !is_of_the_scene(after.run.last_skip->code);
  if (after.verdict == before.verdict) {
    if (is_absent) tell_absence(decision, now);
    return;
  }
  after.run.absence_told = is_absent;
  after.since = now.time.wall;
  decision.alert = alert(before, after, now);
  if (const auto estimate = misalignment(evidence)) decision.alert->misalignment = {estimate->delta, estimate->sigma()};
  const bool cleared = after.verdict == Verdict::calibrated || after.verdict == Verdict::not_evaluated;
  decision.journal.push_back({cleared ? 5 : 4, message_id(after),
                              fmt::format("{}: {} (was {}): {}", settings_.pair, to_string(after.verdict),
                                          to_string(before.verdict), after.reason),
                              fields(after, now.history.in_force()->sequence)});
}

/// A pair that had no verdict before its sensors failed changes none: after `longest_silence` that is told, once.
void PairPipeline::tell_absence(PairDecision& decision, const Now& now) const {
  PairState& after = *decision.state;
  const auto absent = now.time.since_boot - after.run.without_evidence_since.value_or(now.time.since_boot);
  const auto limit = std::max<std::chrono::nanoseconds>(longest_silence, evidence_lifetime(settings_.sampling, {}));
  if (after.run.absence_told || absent < limit) return;
  after.run.absence_told = true;
  decision.alert = alert(after, after, now);
  decision.journal.push_back({4, message_id(after),
                              fmt::format("{}: no evidence for {} s: {}", settings_.pair,
                                          std::chrono::round<std::chrono::seconds>(absent).count(), after.reason),
                              fields(after, now.history.in_force()->sequence)});
}

/// Without an estimate of how far the LiDAR has moved.
DriftAlert PairPipeline::alert(const PairState& before, const PairState& after, const Now& now) const {
  DriftAlert alert;
  alert.stamp = now.time.wall;
  alert.vehicle = settings_.vehicle;
  alert.pair = settings_.pair;
  alert.verdict = after.verdict;
  alert.previous_verdict = before.verdict;
  alert.reason = after.reason;
  alert.misalignment.sigma.setConstant(std::numeric_limits<double>::infinity());
  alert.record_sequence = now.history.in_force() != nullptr ? now.history.in_force()->sequence : now.next_sequence;
  return alert;
}

/// Of an event about the pair, after which it is in this state.
JournalFields PairPipeline::fields(const PairState& after, std::uint64_t record) const {
  return {.pair = settings_.pair,
          .verdict = std::string(to_string(after.verdict)),
          .record = record,
          .reason = after.reason,
          .cause = after.cause ? std::string(to_string(*after.cause)) : ""};
}

std::optional<Grounds> PairPipeline::grounds(const PairState& state, std::optional<std::string> not_written) const {
  const PairRun& run = state.run;
  if (run.pairs == 0 && !not_written) return std::nullopt;
  // The shorter one: a lone delay does not make evidence last longer.
  constexpr std::chrono::nanoseconds longest_cycle = std::chrono::minutes(2);
  const auto cycle = std::min({run.cycles[0], run.cycles[1], longest_cycle});
  return Grounds{.pairs = run.pairs,
                 .taken = run.received,
                 .lifetime = evidence_lifetime(settings_.sampling, cycle),
                 .evidence_sha256 = settings_.evidence_sha256,
                 .not_written = std::move(not_written)};
}

PairStatus PairPipeline::status(const PairState& state, const std::optional<Error>& store_failure,
                                const Now& now) const {
  PairStatus status;
  status.name = settings_.pair;
  status.grounds = grounds(
      state, store_failure ? std::optional(store_failure->context + "; evidence is lost until it can be written again")
                           : now.not_written);
  Claim said = claim(state.claimed(), status.grounds, {now.boot_id, now.time.since_boot});
  status.verdict = said.verdict;
  status.cause = said.cause;
  status.reason = std::move(said.reason);
  status.since = state.since;
  status.last_evaluated = state.last_evaluated;
  status.evaluated = state.evaluated;
  status.skipped = state.skipped;
  status.score = state.score;
  const DriftMonitor drift = monitor(state);
  if (const auto estimate = misalignment(state))
    status.misalignment = PairStatus::Misalignment{estimate->delta, estimate->sigma()};
  if (drift.learned()) {
    status.detection_limit.emplace();
    for (int axis = 0; axis < 6; ++axis) (*status.detection_limit)[axis] = drift.detection_limit(axis);
  }
  if (const double pairs = drift.pairs_to_notice(); std::isfinite(pairs))
    status.notice = {settings_.drift.must_detect_rotation_rad,
                     pairs * std::chrono::duration<double>(settings_.sampling.period).count()};
  status.T_camera_lidar = state.T_camera_lidar;
  return status;
}

}  // namespace calib
