#include "calib_eval/drift_evidence.hpp"

#include <algorithm>
#include <cmath>

#include "calib/quality.hpp"
#include "calib/search.hpp"
#include "calib_eval/parallel.hpp"

namespace calib::eval {
AxisEvidence Ladder::at(double offset, std::size_t frame) const {
  const double place = std::clamp(offset / step, 0.0, static_cast<double>(rungs.size() - 1));
  const auto below = static_cast<std::size_t>(place);
  const double share = place - static_cast<double>(below);
  AxisEvidence between = rungs[below][frame];
  if (share <= 0) return between;
  const AxisEvidence& above = rungs[below + 1][frame];
  between.slope += share * (above.slope - between.slope);
  between.score += share * (above.score - between.score);
  between.prominence += share * (above.prominence - between.prominence);
  *between.sensitivity += share * (*above.sensitivity - *between.sensitivity);
  return between;
}

Result<void> admit(RecordingFrames& recording_frames) {
  std::optional<SceneThumbnail> last;
  std::vector<RecordingFrames::Frame> admitted;
  for (RecordingFrames::Frame& frame : recording_frames.frames) {
    auto good = check_pair(frame.pair, recording_frames.camera, last ? &*last : nullptr, {});
    if (good) good = check_depth(frame.depth, {});
    if (good) {
      last = thumbnail(frame.pair.image);
      admitted.push_back(std::move(frame));
    } else {
      recording_frames.left_out.push_back("frame " + frame.name + " is left out: " + good.error().context);
    }
  }
  recording_frames.frames = std::move(admitted);
  if (recording_frames.frames.size() >= fewest_drift_frames) return {};
  return fail(ErrorCode::too_few_frames,
              std::to_string(recording_frames.frames.size()) + " frames can be used, and at least " +
                  std::to_string(fewest_drift_frames) + " are needed to draw sequences from" +
                  (recording_frames.left_out.empty() ? "" : "; " + recording_frames.left_out.front()));
}

std::size_t places_of(const std::vector<LadderPlan>& plans) {
  std::size_t places = 1;
  for (const LadderPlan& plan : plans) places += static_cast<std::size_t>(plan.rungs);
  return places;
}

Result<DriftEvidence> measure(const RecordingFrames& recording_frames, const std::vector<LadderPlan>& plans,
                              bool monocular_depth, int threads, const std::function<void()>& done) {
  const auto features = recording_frames.features({.min_points = QualityLimits{}.min_points}, threads);
  if (!features) return propagate(features);
  const Objective objective = drift_objective(monocular_depth);
  const auto steps = stencil_steps(monocular_depth);
  DriftEvidence evidence;
  evidence.still.resize(features->size());
  struct Place {
    Vector6 moved = Vector6::Zero();
    std::vector<AxisEvidence>* found;
  };
  std::vector<Place> places{{Vector6::Zero(), &evidence.still}};
  for (const LadderPlan& plan : plans)
    evidence.ladders.push_back(
        {plan.axis, plan.step, {plan.rungs + std::size_t{1}, std::vector<AxisEvidence>(features->size())}});
  for (Ladder& ladder : evidence.ladders)
    for (std::size_t rung = 1; rung < ladder.rungs.size(); ++rung)
      places.push_back({Vector6::Unit(ladder.axis) * ladder.step * static_cast<double>(rung), &ladder.rungs[rung]});
  parallel_for(places.size() * features->size(), threads, [&](std::size_t i) {
    const Place& place = places[i / features->size()];
    const FeatureSet& frame = (*features)[i % features->size()];
    const RigidTransform in_force = recording_frames.T_camera_lidar * perturbation(place.moved).inverse();
    AxisEvidence& found = (*place.found)[i % features->size()];
    found = axis_evidence(evaluate_stencil(frame, in_force, steps, objective), {});
    found.sensitivity = evaluate_sensitivity(frame, in_force, steps, objective);
    done();
  });
  for (Ladder& ladder : evidence.ladders) ladder.rungs[0] = evidence.still;
  return evidence;
}

}  // namespace calib::eval
