#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "message_ids.hpp"
#include "pair_pipeline.hpp"

namespace calib {
namespace {

/// Waiting is doubled no further: a day or two at the default interval.
constexpr int most_doublings = 8;

/// What the evidence of drift says; nothing where there is none, or none but that the extrinsic was wrong from the
/// start.
std::optional<Expectation> expectation(const DriftMonitor& monitor) {
  const auto onset = monitor.onset();
  const auto estimate = monitor.misalignment();
  if (!onset || *onset == Timestamp::min() || !estimate) return std::nullopt;
  Expectation expected{.delta = estimate->delta, .covariance = estimate->covariance};
  for (int axis = 0; axis < 6; ++axis)
    expected.reach[axis] = 1.9 * StencilStep{}.of_axis(axis);  // a little less than 2
  return expected;
}

/// Of the extrinsic in force; nothing while its baseline is learned.
std::optional<BaselineScore> normal_score(const DriftMonitor& monitor, bool monocular_depth) {
  if (!monitor.learned()) return std::nullopt;
  const DriftBaseline& baseline = monitor.state().baseline;
  return BaselineScore{.objective = drift_objective(monocular_depth),
                       .mean = baseline.score,
                       .deviation = std::sqrt(baseline.score_squares / (baseline.pairs - 1)),
                       .pairs = baseline.pairs};
}

}  // namespace

std::size_t PairPipeline::wanted_frames() const {
  return static_cast<std::size_t>(settings_.frames + settings_.frames / 4);
}

/// Those from after the onset of drift; all when there is none.
std::vector<const FeatureSet*> PairPipeline::eligible_frames(const PairState& state) const {
  const Timestamp from = monitor(state).onset().value_or(Timestamp::min());
  std::vector<const FeatureSet*> frames;
  for (const auto& features : state.run.frames)
    if (features->stamp >= from) frames.push_back(features.get());
  return frames;
}

/// "12 of 31"
std::string PairPipeline::progress(const PairState& state) const {
  return fmt::format("{} of {}", eligible_frames(state).size(), wanted_frames());
}

std::chrono::nanoseconds PairPipeline::wait_after_refusals(const PairState& state) const {
  return settings_.min_interval * (1 << std::min(state.refusals, most_doublings));
}

/// Whether it is time for a recalibration that nobody asked for. A clock that was set back does not hold it up.
bool PairPipeline::may_recalibrate(const PairState& state, const Now& now) const {
  if (state.evaluated < state.retry_at) return false;
  if (!state.recalibrated) return true;
  const auto since = now.time.wall - *state.recalibrated;
  return since < since.zero() || since >= wait_after_refusals(state);
}

/// What a recalibration that is wanted waits for.
std::string PairPipeline::next_try(const PairState& state, const Now& now) const {
  if (may_recalibrate(state, now)) return "";
  if (state.evaluated < state.retry_at)
    return fmt::format("; the next is tried after {} more pairs", state.retry_at - state.evaluated);
  return "; the next is tried not before " + rfc3339(*state.recalibrated + wait_after_refusals(state));
}

/// The same pairs would give the same answer: wait for new ones, twice as long each time.
void PairPipeline::count_refusal(PairState& state) const {
  ++state.refusals;
  state.retry_at = state.evaluated + (std::uint64_t{wanted_frames()} << std::min(state.refusals, most_doublings));
}

RecalibrationSettings PairPipeline::recalibration_settings(const PairState& state) const {
  const DriftMonitor drift = monitor(state);
  RecalibrationSettings settings{.bounds = settings_.bounds, .monocular_depth = settings_.monocular_depth};
  if (!drift.onset()) {
    settings.min_change_rotation_rad = settings_.drift.max_bias_rotation_rad;
    settings.min_change_translation_m = settings_.drift.max_bias_translation_m;
  }
  settings.expected = expectation(drift);
  settings.baseline_score = normal_score(drift, settings_.monocular_depth);
  return settings;
}

/// From the eligible frames, of which every fifth is held back. Memory that runs out, and what a library throws, cost
/// the recalibration and no more.
Result<FoundExtrinsic> PairPipeline::search(const PairState& state, const std::function<bool()>& keep_going) const try {
  const auto frames = eligible_frames(state);
  if (frames.size() < wanted_frames())
    return fail(ErrorCode::not_ready,
                "only " + progress(state) + " good pairs are at hand; try again when there are more");
  std::vector<const FeatureSet*> fit, held_back;
  FoundExtrinsic found;
  for (std::size_t i = 0; i < frames.size(); ++i) {
    (i % 5 == 4 ? held_back : fit).push_back(frames[i]);
    found.frames.push_back(frames[i]->stamp);
  }
  RecalibrationSettings settings = recalibration_settings(state);
  settings.keep_going = keep_going;
  auto result = recalibrate(fit, held_back, state.T_camera_lidar, settings);
  if (!result) return propagate(result);
  found.result = std::move(*result);
  return found;
} catch (const std::exception& exception) {
  return fail(ErrorCode::recalibration_failed, std::string("the recalibration was broken off: ") + exception.what());
}

PairDecision PairPipeline::decide(const PairState& state, const Recalibrate& request, const Now& now) const {
  PairDecision decision;
  const auto& found = request.found;
  if (!found) {
    if (found.error().code == ErrorCode::recalibration_failed) {
      decision.state = state;
      ++decision.state->skipped[std::string(to_string(found.error().code))];
    }
    decision.answer = fail(found.error().code == ErrorCode::not_ready ? ErrorCode::not_ready : ErrorCode::failed,
                           found.error().context);
    return decision;
  }
  const Recalibration& result = found->result;
  const Decision by_mode = settings_.mode == RecalibrationMode::apply ? Decision::accepted : Decision::proposed;
  const Decision outcome = result.accepted ? by_mode : Decision::rejected;
  if (request.dry_run) {
    decision.answer = Answer{.decision = outcome, .dry_run = true, .reason = result.reason, .result = result};
    return decision;
  }
  CalibrationRecord record = new_record(outcome, state, request.asked_by, result.reason);
  record.comment = request.comment;
  record.T_camera_lidar = result.T_camera_lidar;
  record.sigma = result.sigma;
  record.score = CalibrationRecord::Score{result.score_before, result.score_after, result.held_back_before,
                                          result.held_back_after};
  for (Timestamp stamp : found->frames) record.frame_stamps_ns.push_back(stamp.count());
  PairState after = state;
  after.recalibrated = now.time.wall;
  if (outcome == Decision::accepted) {
    decision = put_in_force(std::move(record), state, std::move(after), now);
    decision.answer->result = result;
    return decision;
  }
  if (outcome == Decision::proposed)
    after.proposed_record = now.next_sequence;
  else
    count_refusal(after);
  after.run.frames.clear();  // the next one is made from new pairs only
  decision.record = std::move(record);
  decision.state = std::move(after);
  decision.answer = Answer{.decision = outcome, .reason = result.reason, .record = now.next_sequence, .result = result};
  decision.journal.push_back(
      {5, outcome == Decision::proposed ? message_ids::recalibration_proposed : message_ids::recalibration_rejected,
       fmt::format("{}: recalibration {} in record {}: {}", settings_.pair, to_string(outcome), now.next_sequence,
                   result.reason),
       fields(*decision.state, now.next_sequence)});
  return decision;
}

}  // namespace calib
