#include "calib/recalibrate.hpp"

#include <cmath>
#include <cstdio>
#include <string>
#include <vector>

namespace calib {
namespace {

/// How much better `after` is than `before`, frame by frame: mean difference of the scores and its standard error.
struct Gain {
  double mean = 0, standard_error = 0;
  [[nodiscard]] bool exceeds(double sigmas) const { return mean > sigmas * standard_error && mean > 0; }
};
Gain gain(Frames frames, const RigidTransform& before, const RigidTransform& after, const Objective& objective) {
  std::vector<double> differences;
  Gain result;
  for (const FeatureSet* frame : frames) {
    differences.push_back(score(*frame, after, objective).value - score(*frame, before, objective).value);
    result.mean += differences.back();
  }
  const auto n = static_cast<double>(frames.size());
  result.mean /= n;
  double squares = 0;
  for (double difference : differences) squares += (difference - result.mean) * (difference - result.mean);
  result.standard_error = std::sqrt(squares / (n - 1) / n);
  return result;
}

std::string in_words(const Gain& gained) {
  char text[96];
  std::snprintf(text, sizeof text, "score on pairs held back changes by %+.4f +- %.4f", gained.mean,
                gained.standard_error);
  return text;
}

}  // namespace

Result<Recalibration> recalibrate(Frames fit, Frames held_back, const RigidTransform& T_camera_lidar,
                                  const RecalibrationSettings& settings) {
  if (fit.size() < 3 || held_back.size() < 2)
    return fail("too_few_pairs", std::to_string(fit.size()) + " pairs to fit and " + std::to_string(held_back.size()) +
                                     " held back; at least 3 and 2 are needed");
  const SearchSettings rotation{.bounds = settings.bounds, .released = {true, true, true, false, false, false}};
  const SearchSettings everything{.bounds = settings.bounds};
  const auto rotated = search(fit, T_camera_lidar, Method::standard, rotation);
  if (!rotated) return tl::unexpected(rotated.error());
  const auto moved = settings.translation ? search(fit, T_camera_lidar, Method::standard, everything) : rotated;
  if (!moved) return tl::unexpected(moved.error());
  const Objective& objective = moved->objective;

  Recalibration result;
  result.translation_changed =
      gain(held_back, rotated->T_camera_lidar, moved->T_camera_lidar, objective).exceeds(settings.min_gain_sigmas);
  const SearchResult& found = result.translation_changed ? *moved : *rotated;
  result.T_camera_lidar = found.T_camera_lidar;
  result.delta = found.delta;
  result.sigma = uncertainty(fit, result.T_camera_lidar, objective, everything).sigma();
  if (!result.translation_changed)
    result.sigma.head<3>() = uncertainty(fit, result.T_camera_lidar, rotated->objective, rotation).sigma().head<3>();
  result.score_before = mean_score(fit, T_camera_lidar, objective).value;
  result.score_after = mean_score(fit, result.T_camera_lidar, objective).value;
  result.held_back_before = mean_score(held_back, T_camera_lidar, objective).value;
  result.held_back_after = mean_score(held_back, result.T_camera_lidar, objective).value;
  result.evaluations = rotated->evaluations + (settings.translation ? moved->evaluations : 0);

  if (found.ends_at_limit) {
    result.reason = "outside the bounds: " + found.reason;
    return result;
  }
  if (result.delta.head<3>().norm() < settings.min_change_rotation_rad &&
      result.delta.tail<3>().norm() <= settings.min_change_translation_m) {
    result.reason = "the change is no larger than the depth source's own bias may be, and there is no sign of drift";
    return result;
  }
  const Gain gained = gain(held_back, T_camera_lidar, result.T_camera_lidar, objective);
  result.accepted = gained.exceeds(settings.min_gain_sigmas);
  result.reason =
      (result.accepted ? "better on pairs held back: " : "not better on pairs held back: ") + in_words(gained);
  return result;
}

}  // namespace calib
