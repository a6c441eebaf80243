#include "pair_pipeline.hpp"

#include <fmt/format.h>

#include <algorithm>

#include "baseline_record.hpp"
#include "message_ids.hpp"

namespace calib {

PairSettings pair_settings(const Config& config, const PairConfig& pair, std::string evidence_sha256) {
  const bool monocular = depth_kind(pair.depth).is_monocular;
  PairSettings settings{.vehicle = config.vehicle,
                        .pair = pair.name,
                        .camera = pair.camera.camera,
                        .frames = pair.recalibration.frames,
                        .bounds = {pair.recalibration.max_rotation_rad, pair.recalibration.max_translation_m},
                        .quality = {},
                        .drift = usual_drift_settings(monocular),
                        .monocular_depth = monocular,
                        .mode = pair.recalibration.mode,
                        .min_interval = pair.recalibration.min_interval,
                        .sampling = config.sampling,
                        .evidence_sha256 = std::move(evidence_sha256)};
  settings.quality.depth_range = pair.depth_range;
  if (pair.motion) settings.quality.max_turn_rad = pair.motion->max_turn_rad;
  settings.drift.baseline_pairs = pair.drift.baseline_pairs.value_or(settings.drift.baseline_pairs);
  settings.drift.false_alarms_per_pair = false_alarms_per_pair(config, pair.drift);
  settings.drift.must_detect_rotation_rad = pair.drift.must_detect_rad;
  settings.drift.pairs_to_detect =
      std::max(20.0, std::chrono::duration<double>(pair.drift.notice_within) / config.sampling.period);
  settings.drift.min_scene_change = pair.drift.min_scene_change.value_or(settings.drift.min_scene_change);
  return settings;
}

Verdict shown(DriftVerdict verdict) {
  switch (verdict) {
    case DriftVerdict::learning:
    case DriftVerdict::insufficient_power:
      return Verdict::not_evaluated;
    case DriftVerdict::calibrated:
      return Verdict::calibrated;
    case DriftVerdict::suspect:
      return Verdict::suspect;
    case DriftVerdict::drifted:
      return Verdict::drifted;
  }
  return Verdict::not_evaluated;
}

Result<Measurement> PairPipeline::measure(const FramePair& pair, const PairState& state, DepthEstimator& depth,
                                          const std::function<bool()>& keep_going) const {
  // Light, texture and motion, before anything costs time.
  const SceneThumbnail* last_image = state.run.last_image ? &*state.run.last_image : nullptr;
  if (auto usable = check_pair(pair, settings_.camera, last_image, settings_.quality); !usable)
    return propagate(usable);

  // Depth of the image, where it can be believed.
  auto depth_map = depth.estimate(pair);
  if (!depth_map) return propagate(depth_map);
  if (auto masked = mask_depth(pair.image, settings_.quality.depth_range, *depth_map); !masked)
    return propagate(masked);
  if (auto usable = check_depth(*depth_map, settings_.quality); !usable) return propagate(usable);

  // Ranks of depth and of range, of the points that can come into view.
  auto features = make_features(pair, *depth_map, settings_.camera, state.T_camera_lidar,
                                {.bounds = settings_.bounds, .min_points = settings_.quality.min_points});
  if (!features) return propagate(features);

  // Mutual information at the extrinsic in force and one step to either side of it along each axis.
  const Objective objective = drift_objective(settings_.monocular_depth);
  const auto steps = stencil_steps(settings_.monocular_depth);
  const Stencil stencil = evaluate_stencil(*features, state.T_camera_lidar, steps, objective);

  Measurement measurement{.features = std::move(*features),
                          .stencil = stencil,
                          .thumbnail = thumbnail(pair.image),
                          .image_stamp = pair.image.stamp};
  // How the stencil answers to a LiDAR that moves: a part of the baseline.
  if (monitor(state).wants_sensitivity())
    measurement.sensitivity = evaluate_sensitivity(measurement.features, state.T_camera_lidar, steps, objective);
  // What an extrinsic on probation has to be better than.
  if (state.probation)
    measurement.previous_score = score(measurement.features, state.T_camera_lidar_before, objective).value;
  measurement.optimum = find_optimum(state, measurement, keep_going);
  return measurement;
}

Result<RestoredPair> PairPipeline::restore(const Result<std::optional<PairState>>& saved,
                                           const RigidTransform& T_camera_lidar, const Now& now) const {
  RestoredPair restored;
  PairState& state = restored.state;
  PairDecision& decision = restored.decision;
  state.since = now.time.wall;
  state.evidence_sha256 = settings_.evidence_sha256;
  const CalibrationRecord* in_force = now.history.in_force();
  state.T_camera_lidar = in_force != nullptr ? in_force->T_camera_lidar : T_camera_lidar;
  if (!now.history.initial || !same(now.history.initial->T_camera_lidar, T_camera_lidar)) {
    decision.state = state;
    decision.record = new_record(Decision::initial, state, "configuration", "taken from the configuration");
    decision.record->T_camera_lidar = T_camera_lidar;
    if (now.history.initial) tell_new_extrinsic(decision, saved && *saved ? (*saved)->verdict : state.verdict, now);
    return restored;
  }
  if (!saved && saved.error().code != ErrorCode::malformed_state) return propagate(saved);  // it may well be there
  std::string set_aside;
  if (saved && *saved) {
    state = **saved;
    state.put_in_force(*in_force);
    if (state.evidence_sha256 != settings_.evidence_sha256) {
      set_aside = "it was gathered with another configuration, depth model or calibd";
      set_evidence_aside(state, now);
    }
  } else {
    set_aside = saved ? "the store holds none" : saved.error().context;
    state.put_in_force(*in_force);
    set_evidence_aside(state, now);
    if (!now.history.probation_passed()) state.probation.emplace();
  }
  // Nothing is claimed before this process has evidence of its own; what was claimed before is said with the reason.
  PairState& after = decision.state.emplace(state);
  after.set(claim(state.claimed(), std::nullopt, {now.boot_id, now.time.since_boot}));
  if (!set_aside.empty()) {
    after.cause = ErrorCode::starting;
    after.reason = "starting: earlier evidence is set aside: " + set_aside;
    if (state.verdict != after.verdict)
      after.reason += fmt::format("; it was {} when last evaluated", to_string(state.verdict));
    restored.set_aside = {
        4, message_ids::evidence_set_aside,
        fmt::format("{}: earlier evidence is set aside: {}; the baseline is {}", settings_.pair, set_aside,
                    state.drift.baseline.pairs > 0 ? "that of the records" : "learned anew"),
        fields(after, in_force->sequence)};
  }
  finish(decision, state, state, now);
  return restored;
}

/// That the configuration has another extrinsic than it had: somebody has changed it, and the one that calibd had found
/// or confirmed is not in force any more.
void PairPipeline::tell_new_extrinsic(PairDecision& decision, Verdict before, const Now& now) const {
  const CalibrationRecord& last = *now.history.in_force();
  const RigidTransform change = last.T_camera_lidar.inverse() * decision.record->T_camera_lidar;
  const std::string what = fmt::format(
      "the configuration has another extrinsic than before: it is in force by record {}, {:.2f} degrees and {:.1f} cm "
      "from that of record {}, and its baseline is learned anew",
      now.next_sequence, rotation_angle_rad(change) / radians_per_degree, change.translation().norm() * 100,
      last.sequence);
  PairState previous = *decision.state;
  previous.verdict = before;
  decision.alert = alert(previous, *decision.state, now);
  decision.alert->reason = what;
  decision.alert->record_sequence = now.next_sequence;
  decision.journal.push_back(
      {4, message_ids::extrinsic_configured, settings_.pair + ": " + what, fields(*decision.state, now.next_sequence)});
}

/// Evidence, as the records alone tell it, in the place of that of `state`, whose other contents stay.
void PairPipeline::set_evidence_aside(PairState& state, const Now& now) const {
  // What is learned anew at an extrinsic that was wrong would be its baseline.
  if (shown(state.drift.verdict) == Verdict::drifted)
    state.unresolved = "it was drifted before its evidence was set aside";
  state.evidence_sha256 = settings_.evidence_sha256;
  state.drift = {};
  state.score.reset();
  state.proposed_record.reset();
  if (state.probation) state.probation.emplace();
  if (const CalibrationRecord* known = now.history.known_baseline(settings_.evidence_sha256))
    state.drift = learned_state(*known->baseline);
}

CalibrationRecord PairPipeline::new_record(Decision decision, const PairState& state, std::string asked_by,
                                           std::string reason) const {
  CalibrationRecord record;
  record.decision = decision;
  record.asked_by = std::move(asked_by);
  record.reason = std::move(reason);
  record.evidence_sha256 = settings_.evidence_sha256;
  record.T_camera_lidar = record.T_camera_lidar_before = state.T_camera_lidar;
  return record;
}

}  // namespace calib
