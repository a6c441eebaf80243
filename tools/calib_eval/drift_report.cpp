#include "calib_eval/drift_report.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

namespace calib::eval {
namespace {

double shown(int axis, double value) { return is_rotation(axis) ? value / radians_per_degree : value * 100; }

/// Value of rank ceil(share * n).
template <typename T>
std::optional<T> quantile(std::vector<T> values, double share) {
  if (values.empty()) return std::nullopt;
  std::ranges::sort(values);
  const auto rank = static_cast<std::size_t>(std::ceil(share * static_cast<double>(values.size())));
  return values[std::max<std::size_t>(rank, 1) - 1];
}

template <typename T>
Json or_null(const std::optional<T>& value) {
  return value ? Json(*value) : Json(nullptr);
}

const char* name_of(DriftVerdict verdict) {
  switch (verdict) {
    case DriftVerdict::learning:
      return "learning";
    case DriftVerdict::insufficient_power:
      return "insufficient_power";
    case DriftVerdict::calibrated:
      return "calibrated";
    case DriftVerdict::suspect:
      return "suspect";
    case DriftVerdict::drifted:
      return "drifted";
  }
  return "";
}

std::string pairs_text(const std::optional<int>& pairs) { return pairs ? fmt::format("{} pairs", *pairs) : "never"; }

}  // namespace

std::optional<DetectionPower> detection_power(const std::vector<AxisEvidence>& still,
                                              const SequenceSettings& settings) {
  constexpr int vehicles = 101;
  std::array<std::vector<double>, 6> sigmas, detection_limit;
  for (int vehicle = 0; vehicle < vehicles; ++vehicle) {
    const auto monitor = experienced_monitor(still, settings, vehicle);
    if (!monitor) continue;
    const DriftBaseline& baseline = monitor->state().baseline;
    for (int axis = 0; axis < 6; ++axis) {
      const bool seen = baseline.observable(axis);
      sigmas[axis].push_back(seen ? baseline.spread(axis) / std::abs(baseline.sensitivity(axis, axis)) : INFINITY);
      detection_limit[axis].push_back(monitor->detection_limit(axis));
    }
  }
  if (sigmas[0].empty()) return std::nullopt;
  DetectionPower detection_power;
  const auto finite = [](int axis, const std::optional<double>& value) {
    return value && std::isfinite(*value) ? std::optional(shown(axis, *value)) : std::nullopt;
  };
  for (int axis = 0; axis < 6; ++axis)
    detection_power[axis] = {finite(axis, quantile(sigmas[axis], 0.5)),
                             finite(axis, quantile(detection_limit[axis], 0.5))};
  return detection_power;
}

MovedRuns::Summary MovedRuns::summarise() const {
  Summary summary;
  std::vector<double> delays, errors, sigmas;
  for (const MovedRun& run : runs) {
    if (!run.learned) continue;
    ++summary.sequences;
    summary.detected += run.delay.has_value();
    summary.foretold += !run.delay && !run.detectable;
    delays.push_back(run.delay ? static_cast<double>(*run.delay) : INFINITY);
  }
  for (const auto& estimate : estimates) {
    if (!estimate) continue;
    ++summary.estimates;
    summary.within_2_sigma += std::abs(estimate->error) <= 2 * estimate->sigma;
    errors.push_back(std::abs(shown(axis, estimate->error)));
    sigmas.push_back(shown(axis, estimate->sigma));
  }
  const auto pairs = [&](double share) -> std::optional<int> {
    const auto delay = quantile(delays, share);
    if (!delay || !std::isfinite(*delay)) return std::nullopt;
    return static_cast<int>(*delay);
  };
  summary.median_delay = pairs(0.5);
  summary.p95_delay = pairs(0.95);
  summary.estimate_error = quantile(errors, 0.5);
  summary.estimate_sigma = quantile(sigmas, 0.5);
  return summary;
}

void Timeline::add(const DriftMonitor& monitor, bool moved) {
  if (!moved) ++moved_at;
  verdicts.push_back(monitor.verdict());
  std::array<double, 7> now{};
  for (int axis = 0; axis < 6; ++axis) now[static_cast<std::size_t>(axis)] = monitor.evidence(axis);
  now[6] = monitor.loss_evidence();
  evidence.push_back(now);
}

Json to_json(const NullRun& run) {
  return {{"sequences", run.sequences},
          {"decisions", run.decisions},
          {"false_alarms", run.false_alarms},
          {"rate_per_1000_vehicle_weeks", or_null(run.per_1000_weeks())},
          {"upper95", or_null(run.upper95_per_1000_weeks())},
          {"vehicle_weeks", run.weeks},
          {"false_alarms_from_start", run.from_start},
          {"false_suspects", run.false_suspects},
          {"pairs_learning", run.learning},
          {"pairs_without_power", run.insufficient_power}};
}

Json to_json(const MovedRuns& runs, bool with_delays) {
  const MovedRuns::Summary summary = runs.summarise();
  Json json{{"axis", axis_names[runs.axis]},
            {"magnitude", runs.magnitude},
            {"unit", runs.unit},
            {"sequences", summary.sequences},
            {"detected", summary.detected},
            {"median_delay_pairs", or_null(summary.median_delay)},
            {"p95_delay_pairs", or_null(summary.p95_delay)},
            {"estimate_error", or_null(summary.estimate_error)},
            {"estimate_sigma", or_null(summary.estimate_sigma)},
            {"estimates", summary.estimates},
            {"estimates_within_2_sigma", summary.within_2_sigma},
            {"missed_as_foretold", summary.foretold},
            {"without_baseline", static_cast<int>(runs.runs.size()) - summary.sequences}};
  if (!with_delays) return json;
  json["delays"] = json["moved_after"] = Json::array();
  for (const MovedRun& run : runs.runs) {
    if (!run.learned) continue;
    json["delays"].push_back(or_null(run.delay));
    json["moved_after"].push_back(run.pairs_before);
  }
  return json;
}

Json to_json(const Timeline& timeline) {
  Json json{{"axis", axis_names[timeline.of->axis]},
            {"magnitude", timeline.of->magnitude},
            {"unit", timeline.of->unit},
            {"moved_at", timeline.moved_at},
            {"verdict", Json::array()},
            {"evidence", Json::array()}};
  for (const DriftVerdict verdict : timeline.verdicts) json["verdict"].push_back(name_of(verdict));
  for (const auto& evidence : timeline.evidence) json["evidence"].push_back(evidence);
  return json;
}

Json to_json(const std::optional<DetectionPower>& detection_power) {
  if (!detection_power) return nullptr;
  Json axes = Json::array();
  for (int axis = 0; axis < 6; ++axis)
    axes.push_back({{"axis", axis_names[axis]},
                    {"unit", unit_of(axis)},
                    {"sigma_of_pair", or_null((*detection_power)[axis].sigma_of_pair)},
                    {"detection_limit", or_null((*detection_power)[axis].detection_limit)}});
  return axes;
}

Json to_json(const OperatingPoint& point) {
  Json json{{"false_alerts_per_1000_vehicle_weeks", point.false_alerts_per_1000_vehicle_weeks},
            {"null", to_json(point.null)},
            {"knocks", Json::array()}};
  for (const MovedRuns& runs : point.moved) json["knocks"].push_back(to_json(runs, false));
  return json;
}

std::string to_text(const std::optional<DetectionPower>& detection_power) {
  if (!detection_power)
    return "no baseline is ever learned from these frames: they show too few scenes, or misalignment from the start\n";
  std::string lines = fmt::format("{:<6}  {:>16}  {:>17}\n", "axis", "sigma of a pair", "would be noticed");
  const auto value = [](const std::optional<double>& of, int axis) {
    return of ? fmt::format("{:.2f} {}", *of, unit_of(axis)) : "not observable";
  };
  for (int axis = 0; axis < 6; ++axis)
    lines += fmt::format("{:<6}  {:>16}  {:>17}\n", std::string(axis_names[axis]),
                         value((*detection_power)[axis].sigma_of_pair, axis),
                         value((*detection_power)[axis].detection_limit, axis));
  return lines;
}

std::string to_text(const NullRun& run) {
  const auto judged = static_cast<double>(run.decisions);
  std::string lines =
      fmt::format("LiDAR in its place: {} vehicles, {:.0f} vehicle-weeks, {:.3g} % of the pairs with a verdict\n",
                  static_cast<long long>(run.sequences), run.weeks,
                  100 * judged / (judged + static_cast<double>(run.learning + run.insufficient_power)));
  const auto upper = run.upper95_per_1000_weeks();
  if (!upper) return lines + "  no verdict at all: these frames let nothing be judged\n";
  lines += run.false_alarms == 0
               ? fmt::format("  no false alarm: at most {:.3g} in 1000 vehicle-weeks, at 95 %\n", *upper)
               : fmt::format("  {} false alarms: {:.3g} in 1000 vehicle-weeks, at most {:.3g} at 95 %\n",
                             static_cast<long long>(run.false_alarms), *run.per_1000_weeks(), *upper);
  if (run.from_start > 0)
    lines += fmt::format("  {} of them before a baseline was learned: the depth's own bias is taken for misalignment\n",
                         static_cast<long long>(run.from_start));
  lines += fmt::format("  {:.3g} false suspects in 1000 vehicle-weeks\n",
                       1000 * static_cast<double>(run.false_suspects) / run.weeks);
  return lines;
}

std::string drift_heading() {
  return fmt::format("{:<18}  {:>12}  {:>6}  {:>8}  {:>12}  {:>11}  {:>22}", "LiDAR moved by", "found", "missed",
                     "foretold", "median delay", "95 %", "estimate off by (told)");
}

std::string drift_line(const MovedRuns& runs) {
  const MovedRuns::Summary summary = runs.summarise();
  const std::string moved =
      fmt::format("{:<5}  {:+.3g} {}", std::string(axis_names[runs.axis]), runs.magnitude, runs.unit);
  if (summary.sequences == 0) return fmt::format("{:<18}  no baseline is ever learned", moved);
  const int missed = summary.sequences - summary.detected;
  return fmt::format("{:<18}  {:>12}  {:6}  {:8}  {:>12}  {:>11}  {:>22}", moved,
                     fmt::format("{} of {}", summary.detected, summary.sequences), missed, summary.foretold,
                     pairs_text(summary.median_delay), pairs_text(summary.p95_delay),
                     summary.estimate_error ? fmt::format("{:.2g} ({:.2g}) {}", *summary.estimate_error,
                                                          *summary.estimate_sigma, unit_of(runs.axis))
                                            : "-");
}

}  // namespace calib::eval
