#include <cmath>
#include <cstdlib>
#include <iostream>

#include "calib/quality.hpp"
#include "calib_eval/commands.hpp"
#include "calib_eval/drift_report.hpp"
#include "calib_eval/parallel.hpp"
#include "calib_eval/progress.hpp"

namespace calib::eval {
namespace {

constexpr double creeping_rung_rad = 0.125 * radians_per_degree;
/// A LiDAR that creeps is given up when it has turned by so much.
constexpr double farthest_rad = 1 * radians_per_degree;
/// The rest of the operating curve: how many times more false alarms are allowed, and for how many it is waited.
constexpr double allowances[] = {10, 100, 1000, 10000, 100000};
constexpr double alarms_waited_for = 20, fewest_weeks = 100;

/// How a LiDAR is to move, and how that is told.
struct Plan {
  LadderPlan ladder;
  double at_once = 0, per_pair = 0;
  double magnitude = 0;
  const char* unit = "";
};

double per_pair_rad(const RecordingOptions& recording_frames, const DriftOptions& options) {
  return options.rate_deg_per_hour * radians_per_degree * recording_frames.period_s / 3600;
}

/// As calibd's `drift.notice_within` usually is.
double pairs_to_detect(const RecordingOptions& recording_frames) { return 2 * 3600 / recording_frames.period_s; }

int pairs_of(const RecordingOptions& recording_frames, const DriftOptions& options) {
  if (options.pairs > 0) return options.pairs;
  const double rate = per_pair_rad(recording_frames, options);
  return static_cast<int>(std::ceil(rate > 0 ? farthest_rad / rate : pairs_to_detect(recording_frames)));
}

std::vector<Plan> plans_of(const RecordingOptions& recording_frames, const DriftOptions& options) {
  std::vector<Plan> plans;
  if (const double rate = per_pair_rad(recording_frames, options); rate > 0) {
    const double end = rate * pairs_of(recording_frames, options);
    const int rungs = static_cast<int>(std::ceil(end / creeping_rung_rad));
    for (int axis = 0; axis < 3; ++axis)
      for (const int side : {1, -1})
        plans.push_back(
            {{axis, side * creeping_rung_rad, rungs}, 0, side * rate, side * options.rate_deg_per_hour, "deg/h"});
    return plans;
  }
  for (const KnockSize& knock : options.knocks)
    for (int axis = knock.rotation ? 0 : 3; axis < (knock.rotation ? 3 : 6); ++axis)
      for (const int side : {1, -1}) {
        const double moved = side * knock.size;
        plans.push_back(
            {{axis, moved, 1}, moved, 0, knock.rotation ? moved / radians_per_degree : moved * 100, unit_of(axis)});
      }
  return plans;
}

std::vector<std::vector<bool>> same_scene(const RecordingFrames& recording_frames, double min_scene_change) {
  std::vector<SceneThumbnail> thumbnails;
  for (const auto& frame : recording_frames.frames) thumbnails.push_back(thumbnail(frame.pair.image));
  std::vector<std::vector<bool>> same;
  for (const SceneThumbnail& one : thumbnails) {
    same.emplace_back();
    for (const SceneThumbnail& other : thumbnails) same.back().push_back(scene_change(one, other) < min_scene_change);
  }
  return same;
}

SequenceSettings settings_for(const RecordingOptions& recording_frames, const DriftOptions& options,
                              const RecordingFrames& read) {
  const std::size_t frames = read.frames.size();
  SequenceSettings settings;
  settings.block = options.block ? static_cast<std::size_t>(*options.block) : usual_block(frames);
  settings.period_s = recording_frames.period_s;
  settings.driving_hours_per_week = options.driving_hours_per_week;
  settings.seed = recording_frames.seed;
  settings.threads = recording_frames.threads;
  settings.drift = usual_drift_settings(recording_frames.monocular_depth());
  settings.same_scene = same_scene(read, settings.drift.min_scene_change);
  settings.drift.pairs_to_detect = pairs_to_detect(recording_frames);
  settings.drift.false_alarms_per_pair =
      options.false_alerts_per_1000_vehicle_weeks / (1000 * settings.pairs_per_week());
  return settings;
}

/// What is measured, and how sequences of it are made.
struct Study {
  const RecordingOptions& recording_frames;
  const DriftOptions& options;
  DriftEvidence evidence;
  std::vector<Plan> plans;
  SequenceSettings settings;
  const RecordingFrames& read;
  std::vector<FeatureSet> features;  // for estimates
  std::optional<DriftMonitor> experienced;

  [[nodiscard]] Movement movement(std::size_t plan) const {
    return {&evidence.ladders[plan], plans[plan].at_once, plans[plan].per_pair};
  }
  [[nodiscard]] NullRun without_drift(const SequenceSettings& judged, double weeks) const;
  [[nodiscard]] MovedRuns with_drift(const SequenceSettings& judged, std::size_t plan) const;
  [[nodiscard]] std::vector<std::optional<Estimate>> estimates(std::size_t plan) const;
  [[nodiscard]] OperatingPoint operating_point(double allowance) const;
  [[nodiscard]] Json timelines(const std::vector<MovedRuns>& moved) const;
};

NullRun Study::without_drift(const SequenceSettings& judged, double weeks) const {
  Progress progress("vehicles whose LiDAR stays", vehicles_for(weeks));
  return drive_without_drift(evidence.still, judged, weeks, [&] { progress.step(); });
}

MovedRuns Study::with_drift(const SequenceSettings& judged, std::size_t plan) const {
  const Plan& moves = plans[plan];
  MovedRuns moved{moves.ladder.axis, moves.magnitude, moves.unit, std::vector<MovedRun>(options.sequences), {}};
  const int pairs = pairs_of(recording_frames, options);
  parallel_for(moved.runs.size(), recording_frames.threads,
               [&](std::size_t i) { moved.runs[i] = drive_with(movement(plan), evidence.still, judged, pairs, i); });
  return moved;
}

/// Of a LiDAR that has been knocked; one that creeps is in many places.
std::vector<std::optional<Estimate>> Study::estimates(std::size_t plan) const {
  const Plan& moves = plans[plan];
  if (!experienced || moves.per_pair != 0) return {};
  return estimates_of(features, read.T_camera_lidar, moves.ladder.axis, moves.at_once,
                      recording_frames.monocular_depth(), *experienced, settings, options.estimates);
}

OperatingPoint Study::operating_point(double allowance) const {
  SequenceSettings judged = settings;
  judged.drift.false_alarms_per_pair *= allowance;
  OperatingPoint point{options.false_alerts_per_1000_vehicle_weeks * allowance, {}, {}};
  const double enough = 1000 * alarms_waited_for / point.false_alerts_per_1000_vehicle_weeks;
  point.null = without_drift(judged, std::min(options.weeks, std::max(fewest_weeks, enough)));
  for (std::size_t plan = 0; plan < plans.size(); ++plan) point.moved.push_back(with_drift(judged, plan));
  return point;
}

/// Of the first sequence of the smallest movement along each axis, to the positive side.
Json Study::timelines(const std::vector<MovedRuns>& moved) const {
  Json timelines = Json::array();
  for (int axis = 0; axis < 6; ++axis) {
    std::optional<std::size_t> smallest;
    for (std::size_t i = 0; i < moved.size(); ++i)
      if (moved[i].axis == axis && moved[i].magnitude > 0 &&
          (!smallest || moved[i].magnitude < moved[*smallest].magnitude))
        smallest = i;
    if (!smallest) continue;
    Timeline timeline{&moved[*smallest], 0, {}, {}};
    const auto run = drive_with(movement(*smallest), evidence.still, settings, pairs_of(recording_frames, options), 0,
                                [&](const DriftMonitor& monitor, bool has_moved) { timeline.add(monitor, has_moved); });
    if (run.learned) timelines.push_back(to_json(timeline));
  }
  return timelines;
}

Json describe_settings(const Study& study) {
  const SequenceSettings& settings = study.settings;
  return {{"block", settings.block},
          {"period_s", settings.period_s},
          {"driving_hours_per_week", settings.driving_hours_per_week},
          {"false_alerts_per_1000_vehicle_weeks", study.options.false_alerts_per_1000_vehicle_weeks},
          {"pairs", pairs_of(study.recording_frames, study.options)},
          {"baseline_pairs", settings.drift.baseline_pairs},
          {"max_baseline_pairs", settings.drift.max_baseline_pairs},
          {"monocular_depth", study.recording_frames.monocular_depth()}};
}

/// Blocks are drawn from among others: of one alone, all sequences are the same.
Result<void> check_block(const DriftOptions& options, std::size_t frames) {
  if (!options.block || 2 * static_cast<std::size_t>(*options.block) <= frames) return {};
  return fail(ErrorCode::bad_block, "--block " + std::to_string(*options.block) + " is more than half of the " +
                                        std::to_string(frames) + " frames: sequences would hardly differ");
}

Result<Study> study_of(const RecordingOptions& recording_options, const DriftOptions& options,
                       const RecordingFrames& recording_frames) {
  Study study{recording_options,
              options,
              {},
              plans_of(recording_options, options),
              settings_for(recording_options, options, recording_frames),
              recording_frames,
              {},
              {}};
  std::vector<LadderPlan> ladders;
  for (const Plan& plan : study.plans) ladders.push_back(plan.ladder);
  Progress progress("evidence", places_of(ladders) * recording_frames.frames.size());
  auto evidence = measure(recording_frames, ladders, recording_options.monocular_depth(), recording_options.threads,
                          [&] { progress.step(); });
  if (!evidence) return propagate(evidence);
  study.evidence = *std::move(evidence);
  study.experienced = experienced_monitor(study.evidence.still, study.settings, 0);
  // Searches begin where the LiDAR is thought to be and end where it is.
  auto features = recording_frames.features(
      {.bounds = {2 * SearchBounds{}.rotation_rad, 2 * SearchBounds{}.translation_m}}, recording_options.threads);
  if (!features) return propagate(features);
  study.features = *std::move(features);
  return study;
}

}  // namespace

Result<KnockSize> parse_knock(const std::string& text) {
  char* unit = nullptr;
  const double number = std::strtod(text.c_str(), &unit);
  const bool rotation = std::string_view(unit) == "deg";
  const double most = rotation ? 5 : 50;
  if ((!rotation && std::string_view(unit) != "cm") || !(number > 0) || number > most)
    return fail(ErrorCode::bad_knock,
                text +
                    " is neither an angle such as 0.25deg, up to 5deg, nor a distance such as 10cm, up to "
                    "50cm; both are more than nothing");
  return KnockSize{rotation, rotation ? number * radians_per_degree : number / 100};
}

Result<Doubts> drift(const RecordingOptions& recording_options, const DriftOptions& options,
                     const CommandWords& words) {
  const auto file = ResultFile::at(options.json);  // before minutes of work
  if (!file) return propagate(file);
  auto recording_frames = read_recording_frames(recording_options);
  if (!recording_frames) return propagate(recording_frames);
  const std::size_t told = recording_frames->left_out.size();
  const auto enough = admit(*recording_frames);
  for (std::size_t i = told; i < recording_frames->left_out.size(); ++i)
    std::cerr << "calib-eval: " << escape_control(recording_frames->left_out[i]) << '\n';
  if (!enough) return propagate(enough);
  if (auto possible = check_block(options, recording_frames->frames.size()); !possible) return propagate(possible);
  Json result = describe("drift", words, recording_options, *recording_frames);
  const Doubts doubts = doubts_of(*recording_frames);
  result["doubts"] = to_json(doubts);
  const auto study = study_of(recording_options, options, *recording_frames);
  if (!study) return propagate(study);
  result["settings"] = describe_settings(*study);

  std::cout << recording_frames->frames.size() << " frames, vector instructions " << vector_instructions() << ".\n"
            << "Sequences are drawn from these frames, " << study->settings.block
            << " neighbours at a time: what none of them shows happens in no sequence.\n";
  print_doubts(doubts);
  std::cout << '\n';
  const auto axes = detection_power(study->evidence.still, study->settings);
  result["axes"] = to_json(axes);
  std::cout << to_text(axes) << std::endl;
  const NullRun null = study->without_drift(study->settings, options.weeks);
  result["null"] = to_json(null);
  std::cout << to_text(null) << '\n' << drift_heading() << std::endl;
  std::vector<MovedRuns> moved;
  result["knocks"] = Json::array();
  for (std::size_t plan = 0; plan < study->plans.size(); ++plan) {
    moved.push_back(study->with_drift(study->settings, plan));
    moved.back().estimates = study->estimates(plan);
    result["knocks"].push_back(to_json(moved.back(), true));
    std::cout << drift_line(moved.back()) << std::endl;
  }
  if (options.json.empty()) return doubts;
  result["timelines"] = study->timelines(moved);
  result["operating"] = {to_json(OperatingPoint{options.false_alerts_per_1000_vehicle_weeks, null, moved})};
  for (const double allowance : allowances) result["operating"].push_back(to_json(study->operating_point(allowance)));
  if (auto written = file->write(result, true); !written) return propagate(written);
  return doubts;
}

}  // namespace calib::eval
