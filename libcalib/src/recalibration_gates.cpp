#include "recalibration_gates.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "search_steps.hpp"

namespace calib {
namespace {

constexpr double most_deviations = 3;
/// A smaller change of the score carries no information, however significant it is: frames that are all alike have no
/// scatter.
constexpr double negligible_gain = 5e-4;
/// Scenery changes the information (the score less one) of 20 pairs of one depth source against 20 others by up to 3 %;
/// a smooth bias of 30 % takes 9 to 16 %.
constexpr double tolerated_loss = 0.1;

Matrix6 squares_of(double rotation_rad, double translation_m) {
  Vector6 each;
  each << Eigen::Vector3d::Constant(rotation_rad), Eigen::Vector3d::Constant(translation_m);
  return each.cwiseAbs2().asDiagonal();
}

/// How far `difference` is from zero along `axes`, in standard deviations (Mahalanobis 1936), beyond what chance makes
/// of so many axes, which grows like the root of their number: above 3 about three times in a thousand.
double deviations(const Vector6& difference, const Matrix6& covariance, const std::vector<int>& axes) {
  const Eigen::VectorXd d = difference(axes);
  const Eigen::MatrixXd c = covariance(axes, axes);
  return axes.empty() ? 0 : std::sqrt(std::max(0.0, d.dot(c.ldlt().solve(d)))) - std::sqrt(axes.size()) + 1;
}

std::vector<int> axes_where(const std::array<bool, 6>& chosen) {
  std::vector<int> axes;
  for (int axis = 0; axis < 6; ++axis)
    if (chosen[axis]) axes.push_back(axis);
  return axes;
}

std::string number(double value, int decimals) { return fmt::format("{:.{}f}", value, decimals); }

/// "+0.0123 +- 0.0040".
std::string in_words(const Gain& gained) {
  return fmt::format("{:+.4f} +- {:.4f}", gained.mean, gained.standard_error);
}

/// "roll 0.31, yaw -1.20 degrees, x 4 cm": of these axes.
std::string in_words(const Vector6& delta, const std::vector<int>& axes) {
  std::string text;
  for (std::size_t i = 0; i < axes.size(); ++i) {
    const int axis = axes[i];
    const bool last_of_unit = i + 1 == axes.size() || (axis < 3 && axes[i + 1] >= 3);
    text += (i == 0 ? "" : ", ") + std::string(axis_names[axis]) + " ";
    text += axis < 3 ? number(delta[axis] / radians_per_degree, 2) : number(100 * delta[axis], 0);
    if (last_of_unit) text += axis < 3 ? " degrees" : " cm";
  }
  return text;
}

/// The expectation for a candidate that did not move all axes: conditional on the others not having moved.
Expectation given_that_others_rest(const Expectation& expected, const std::array<bool, 6>& moved) {
  std::array<bool, 6> rest{};
  for (int axis = 0; axis < 6; ++axis) rest[axis] = !moved[axis];
  const std::vector<int> free = axes_where(moved), fixed = axes_where(rest);
  if (fixed.empty()) return expected;
  Matrix6 covariance = expected.covariance + squares_of(1e-6, 1e-6);
  const Eigen::MatrixXd of_fixed = covariance(fixed, fixed), of_both = covariance(fixed, free);
  const Eigen::MatrixXd gain = of_fixed.ldlt().solve(of_both).transpose();
  Expectation given{.delta = Vector6::Zero(), .covariance = Matrix6::Identity(), .reach = expected.reach};
  given.delta(free) = expected.delta(free) - gain * expected.delta(fixed);
  given.covariance(free, free) = covariance(free, free) - gain * covariance(fixed, free);
  return given;
}

}  // namespace

std::vector<const FeatureSet*> Candidate::all_frames() const {
  std::vector<const FeatureSet*> all(fit.begin(), fit.end());
  all.insert(all.end(), held_back.begin(), held_back.end());
  return all;
}

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

Objection insufficient_observability(const Candidate& candidate) {
  const auto moved = axes_where(candidate.free_axes);
  const auto rotations = std::ranges::count_if(moved, [](int axis) { return axis < 3; });
  if (rotations >= 2 && moved.size() > axes_where(candidate.left).size()) return {};
  return fmt::format("insufficient observability: only {} axes are observable", moved.size());
}

Objection outside_bounds(const Candidate& candidate) {
  if (candidate.at_limit.empty()) return {};
  return "outside the bounds: " + candidate.at_limit;
}

Objection no_more_than_bias(const Candidate& candidate, const RecalibrationSettings& settings) {
  if (candidate.delta.head<3>().norm() >= settings.min_change_rotation_rad ||
      candidate.delta.tail<3>().norm() > settings.min_change_translation_m)
    return {};
  return "the change is no larger than the depth source's bias may be, and there is no evidence of drift";
}

std::string held_back_in_words(const Gain& held_back) {
  return "score on pairs held back changes by " + in_words(held_back);
}

Objection not_better(const Gain& held_back, const RecalibrationSettings& settings) {
  if (held_back.mean > std::max(settings.min_gain_sigmas * held_back.standard_error, negligible_gain)) return {};
  return "not better on pairs held back: " + held_back_in_words(held_back);
}

Objection contradicts_expectation(const Candidate& candidate, const Expectation& expected) {
  const Expectation given = given_that_others_rest(expected, candidate.free_axes);
  // Slopes are proportional to the shift only near the maximum. Far from it they show little more than its direction.
  constexpr double share = 0.3;
  Matrix6 covariance = given.covariance + candidate.covariance + squares_of(0.2 * radians_per_degree, 0.08);
  covariance += (share * given.delta).cwiseAbs2().asDiagonal();
  const bool near = ((candidate.delta.cwiseAbs() - expected.reach / 2).array() < 0).all();
  std::array<bool, 6> compared = candidate.free_axes;
  for (int axis = 0; axis < 6; ++axis)
    if (!near || std::abs(given.delta[axis]) >= given.reach[axis])
      compared[axis] = compared[axis] && candidate.delta[axis] * given.delta[axis] < 0 &&
                       std::abs(given.delta[axis]) > given.reach[axis] / 2;
  const std::vector<int> axes = axes_where(compared);
  const double off = deviations(candidate.delta - given.delta, covariance, axes);
  if (off <= most_deviations) return {};
  return "contradicts the evidence of drift, by " + number(off, 1) + " standard deviations: found " +
         in_words(candidate.delta, axes) + "; expected " + in_words(given.delta, axes);
}

Objection contradicts_intensity(const Candidate& candidate) {
  const Gain gained = gain(candidate.all_frames(), candidate.T_before, candidate.T_after,
                           objective_of({{FeaturePair::intensity, 1, 8, true}}));
  if (-gained.mean <= std::max(most_deviations * gained.standard_error, negligible_gain)) return {};
  return "intensity contradicts: the score of brightness against reflectance changes by " + in_words(gained);
}

Objection score_not_restored(const Candidate& candidate, const BaselineScore& baseline) {
  const auto frames = candidate.all_frames();
  const double now = mean_score(frames, candidate.T_after, baseline.objective).value;
  const double standard_error =
      baseline.deviation * std::sqrt(1.0 / static_cast<double>(frames.size()) + 1.0 / std::max(1, baseline.pairs));
  if (baseline.mean - now <= most_deviations * standard_error + tolerated_loss * (baseline.mean - 1)) return {};
  return "depth is not what it was: the score is " + number(now, 4) + " there, and " + number(baseline.mean, 4) +
         " +- " + number(standard_error, 4) + " is the baseline";
}

Result<Objection> not_repeatable(const Candidate& candidate, const std::function<bool()>& keep_going,
                                 int& evaluations) {
  // Near enough that good depth needs no grid search, and far enough for the basin of another local maximum.
  const SearchSettings near{.bounds = {2.4 * radians_per_degree, 0.5},
                            .free_axes = candidate.free_axes,
                            .monocular_depth = candidate.monocular_depth,
                            .keep_going = keep_going};
  const std::vector<int> axes = axes_where(candidate.free_axes);
  // Each of two starts uses one half of the frames, so that both together take no longer than one search. The optimum
  // of a half differs from that of all frames by about as much as the latter from the truth.
  const Matrix6 explained = candidate.covariance + squares_of(0.15 * radians_per_degree, 0.1);
  for (const std::size_t half : {0, 1}) {
    Vector6 off;
    off << 0.7 * radians_per_degree, -0.7 * radians_per_degree, 0.7 * radians_per_degree, 0.1, 0.05, -0.05;
    for (int axis = 0; axis < 6; ++axis) off[axis] *= !candidate.free_axes[axis] ? 0 : half == 0 ? 1 : -1;
    std::vector<const FeatureSet*> frames;
    for (std::size_t i = half; i < candidate.fit.size(); i += 2) frames.push_back(candidate.fit[i]);
    const auto again = search(frames, candidate.T_after * perturbation(off), Method::standard, near);
    if (!again) return propagate(again);
    evaluations += again->evaluations;
    const Vector6 difference = perturbation_parameters(candidate.T_after.inverse() * again->T_camera_lidar);
    if (const double apart = deviations(difference, explained, axes); apart > most_deviations)
      return Objection("a false optimum: from another start the search ends elsewhere, off by " +
                       in_words(difference, axes) + ", which is " + number(apart, 1) + " standard deviations");
  }
  return Objection();
}

}  // namespace calib
