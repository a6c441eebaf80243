#include "calib_eval/drift_sequences.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "calib_eval/parallel.hpp"
#include "vehicle/random.hpp"

namespace calib::eval {
namespace {

enum Purpose : std::uint64_t { null_frames, peace, moved_frames };

/// A depth source whose bias is taken for misalignment never lets a baseline be learned.
constexpr int patience_pairs = 1000;

/// One vehicle: evidence that is drawn goes to a monitor as a daemon's would.
class Journey {
 public:
  Journey(const std::vector<AxisEvidence>& still, const SequenceSettings& settings, std::uint64_t key)
      : monitor(settings.drift),
        still_(still),
        same_scene_(settings.same_scene),
        draw_(still.size(), settings.block, key),
        period_(static_cast<Timestamp::rep>(settings.period_s * 1e9)) {}

  DriftVerdict drive() {
    const std::size_t frame = draw_.next();
    return show(still_[frame], frame);
  }
  DriftVerdict drive(const Ladder& ladder, double offset) {
    const std::size_t frame = draw_.next();
    return show(ladder.at(offset, frame), frame);
  }

  DriftMonitor monitor;

 private:
  DriftVerdict show(const AxisEvidence& evidence, std::size_t frame) {
    shown_.same_scene = scene_ && !same_scene_.empty() && same_scene_[*scene_][frame];
    if (!shown_.same_scene) scene_ = frame;
    shown_.stamp += period_;
    shown_.slope = evidence.slope;
    shown_.score = evidence.score;
    shown_.prominence = evidence.prominence;
    if (monitor.wants_sensitivity())
      shown_.sensitivity = evidence.sensitivity;
    else
      shown_.sensitivity.reset();
    return monitor.observe(shown_).value();  // has a response where one is needed
  }

  const std::vector<AxisEvidence>& still_;
  const std::vector<std::vector<bool>>& same_scene_;
  std::optional<std::size_t> scene_;  // the frame that a scene began with
  FrameDraw draw_;
  Timestamp period_;
  AxisEvidence shown_;
};

NullRun drive_one(const std::vector<AxisEvidence>& still, const SequenceSettings& settings, std::int64_t pairs,
                  std::size_t number) {
  NullRun run;
  Journey journey(still, settings, vehicle::mix(settings.seed, null_frames, number));
  DriftVerdict before = DriftVerdict::learning;
  for (std::int64_t pair = 0; pair < pairs; ++pair) {
    const DriftVerdict verdict = journey.drive();
    run.learning += verdict == DriftVerdict::learning;
    run.insufficient_power += verdict == DriftVerdict::insufficient_power;
    run.false_suspects += verdict == DriftVerdict::suspect && before != DriftVerdict::suspect;
    before = verdict;
    if (verdict != DriftVerdict::drifted) continue;
    ++run.false_alarms;
    run.from_start += !journey.monitor.learned();
    journey.monitor.restart();
    before = DriftVerdict::learning;
  }
  run.decisions = pairs - run.learning - run.insufficient_power;
  return run;
}

}  // namespace

std::size_t FrameDraw::next() {
  if (left_ == 0) {
    // The upper bits of a product instead of a division: this is the inner loop of weeks of driving.
    at_ = static_cast<std::size_t>((vehicle::mix(key_, drawn_++) >> 32) * frames_ >> 32);
    left_ = block_;
  }
  --left_;
  const std::size_t frame = at_;
  at_ = at_ + 1 == frames_ ? 0 : at_ + 1;
  return frame;
}

std::size_t usual_block(std::size_t frames) {
  return static_cast<std::size_t>(std::max(1L, std::lround(std::cbrt(static_cast<double>(frames)))));
}

std::optional<double> NullRun::per_1000_weeks() const {
  return decisions > 0 ? std::optional(1000 * static_cast<double>(false_alarms) / weeks) : std::nullopt;
}

std::optional<double> NullRun::upper95_per_1000_weeks() const {
  return decisions > 0 ? std::optional(1000 * poisson_upper95(false_alarms) / weeks) : std::nullopt;
}

double poisson_upper95(std::int64_t count) {
  // From the most probable term down, each from the one before it.
  const auto at_most = [&](double mean) {
    const auto most = static_cast<double>(count);
    double term = std::exp(most * std::log(mean) - mean - std::lgamma(most + 1)), sum = 0;
    for (std::int64_t i = count; i >= 0 && term > 1e-18 * sum; term *= static_cast<double>(i--) / mean) sum += term;
    return sum;
  };
  double low = static_cast<double>(count), high = low + 5 * std::sqrt(low) + 10;
  for (int i = 0; i < 100; ++i) {
    const double middle = (low + high) / 2;
    (at_most(middle) > 0.05 ? low : high) = middle;
  }
  return high;
}

std::size_t vehicles_for(double weeks) {
  return static_cast<std::size_t>(std::max(1.0, std::ceil(weeks / weeks_per_vehicle)));
}

NullRun drive_without_drift(const std::vector<AxisEvidence>& still, const SequenceSettings& settings, double weeks,
                            const std::function<void()>& done) {
  std::vector<NullRun> runs(vehicles_for(weeks));
  parallel_for(runs.size(), settings.threads, [&](std::size_t vehicle) {
    const double of_this = std::min(weeks_per_vehicle, weeks - static_cast<double>(vehicle) * weeks_per_vehicle);
    runs[vehicle] = drive_one(still, settings, std::llround(of_this * settings.pairs_per_week()), vehicle);
    done();
  });
  NullRun all;
  for (const NullRun& run : runs) {
    ++all.sequences;
    all.decisions += run.decisions;
    all.learning += run.learning;
    all.insufficient_power += run.insufficient_power;
    all.false_alarms += run.false_alarms;
    all.from_start += run.from_start;
    all.false_suspects += run.false_suspects;
  }
  all.weeks = static_cast<double>(all.decisions + all.learning + all.insufficient_power) / settings.pairs_per_week();
  return all;
}

std::optional<DriftMonitor> experienced_monitor(const std::vector<AxisEvidence>& still,
                                                const SequenceSettings& settings, std::size_t number) {
  Journey journey(still, settings, vehicle::mix(settings.seed, null_frames, number));
  for (int pair = 0; pair < patience_pairs && journey.monitor.wants_sensitivity(); ++pair)
    if (journey.drive() == DriftVerdict::drifted) journey.monitor.restart();
  return journey.monitor.learned() ? std::optional(std::move(journey.monitor)) : std::nullopt;
}

MovedRun drive_with(const Movement& movement, const std::vector<AxisEvidence>& still, const SequenceSettings& settings,
                    int pairs, std::size_t number, const Watch& watch) {
  MovedRun run;
  Journey journey(still, settings, vehicle::mix(settings.seed, moved_frames, number));
  const int axis = movement.ladder->axis;
  const int peaceful = vehicle::Random(vehicle::mix(settings.seed, peace, number)).below(most_pairs_before + 1);
  const auto seen = [&](bool moved) {
    if (watch) watch(journey.monitor, moved);
  };
  for (int left = peaceful + 1; left > 0 || !journey.monitor.learned(); ++run.pairs_before) {
    if (run.pairs_before == patience_pairs) return run;
    if (journey.drive() == DriftVerdict::drifted) journey.monitor.restart();
    seen(false);
    left = journey.monitor.learned() ? left - 1 : peaceful + 1;
  }
  run.learned = true;
  run.detectable = journey.monitor.detection_limit(axis) <= std::abs(movement.offset(pairs));
  for (int pair = 1; pair <= pairs && !run.delay; ++pair) {
    const DriftVerdict verdict = journey.drive(*movement.ladder, movement.offset(pair));
    seen(true);
    if (verdict == DriftVerdict::drifted) run.delay = pair;
  }
  return run;
}

}  // namespace calib::eval
