#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "calib/search.hpp"
#include "search_steps.hpp"

namespace calib {
namespace {

/// Steps of the differences: within the basin, and larger than the effect of single pixels.
constexpr double rotation_step_rad = 0.3 * radians_per_degree, translation_step_m = 0.08;
constexpr int resamples = 400;
constexpr double observable_sigmas = 3;

/// First and second central differences of one frame's score, scaled: a unit is the axis' bound.
struct Slopes {
  Vector6 gradient = Vector6::Zero();
  Matrix6 hessian = Matrix6::Zero();
};

/// Perturbations turn about `pivot` (LiDAR frame).
Slopes slopes(const FeatureSet& frame, const RigidTransform& T, const Eigen::Vector3d& pivot,
              const Objective& objective, const SearchSettings& settings, const Vector6& scale) {
  const auto step = [](int axis) { return axis < 3 ? rotation_step_rad : translation_step_m; };
  const auto at = [&](const Vector6& delta) {
    return score(frame, T * perturbation_about(delta, pivot), objective).value;
  };
  const double here = at(Vector6::Zero());
  Vector6 plus = Vector6::Zero(), minus = Vector6::Zero();
  Slopes result;
  for (int i = 0; i < 6; ++i) {
    if (!settings.free_axes[i]) continue;
    const Vector6 move = Vector6::Unit(i) * step(i);
    plus[i] = at(move);
    minus[i] = at(-move);
    const double h = step(i) / scale[i];
    result.gradient[i] = (plus[i] - minus[i]) / (2 * h);
    result.hessian(i, i) = (plus[i] - 2 * here + minus[i]) / (h * h);
    for (int j = 0; j < i; ++j) {
      if (!settings.free_axes[j]) continue;
      const Vector6 both = move + Vector6::Unit(j) * step(j);
      result.hessian(i, j) =
          (at(both) + at(-both) - plus[i] - minus[i] - plus[j] - minus[j] + 2 * here) / (2 * h * step(j) / scale[j]);
      result.hessian(j, i) = result.hessian(i, j);
    }
  }
  return result;
}

/// SplitMix64 (Steele 2014), for resampling the same way each time.
struct Sequence {
  std::uint64_t state = 1;
  std::size_t below(std::size_t n) {
    std::uint64_t z = state += 0x9e3779b97f4a7c15;
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9;
    z = (z ^ (z >> 27)) * 0x94d049bb133111eb;
    return static_cast<std::size_t>((z ^ (z >> 31)) % n);
  }
};

/// Covariance of the mean gradient over resampled blocks of neighbouring frames.
Matrix6 bootstrap(const std::vector<Slopes>& frames, const Vector6& mean) {
  const std::size_t n = frames.size();
  const auto block = static_cast<std::size_t>(std::ceil(std::cbrt(static_cast<double>(n))));
  Sequence sequence;
  Matrix6 covariance = Matrix6::Zero();
  for (int resample = 0; resample < resamples; ++resample) {
    Vector6 sum = Vector6::Zero();
    for (std::size_t taken = 0; taken < n;) {
      const std::size_t first = sequence.below(n);
      for (std::size_t i = 0; i < block && taken < n; ++i, ++taken) sum += frames[(first + i) % n].gradient;
    }
    const Vector6 away = sum / static_cast<double>(n) - mean;
    covariance += away * away.transpose() / resamples;
  }
  return covariance;
}

/// Whether the mean of the frames' curvatures along an axis is significantly that of a maximum.
bool has_maximum(const std::vector<Slopes>& frames, int axis) {
  double mean = 0, squares = 0;
  const auto n = static_cast<double>(frames.size());
  for (const Slopes& frame : frames) mean += frame.hessian(axis, axis) / n;
  for (const Slopes& frame : frames) squares += std::pow(frame.hessian(axis, axis) - mean, 2);
  return n > 1 && mean < -observable_sigmas * std::sqrt(squares / (n - 1) / n);
}

}  // namespace

Uncertainty uncertainty(Frames frames, const RigidTransform& T_camera_lidar, const Objective& objective,
                        const SearchSettings& settings) {
  Uncertainty result;
  if (frames.empty()) return result;
  Vector6 scale;
  for (int axis = 0; axis < 6; ++axis)
    scale[axis] = std::max(1e-9, axis < 3 ? settings.bounds.rotation_rad : settings.bounds.translation_m);
  // As in the search: about a point in the scene, where the six parameters are hardly correlated.
  const bool everything = std::ranges::all_of(settings.free_axes, [](bool axis) { return axis; });
  const Eigen::Vector3d pivot =
      everything ? Eigen::Vector3d(T_camera_lidar.inverse() * Eigen::Vector3d(0, 0, pivot_distance_m))
                 : Eigen::Vector3d(0, 0, 0);
  std::vector<Slopes> all;
  Slopes mean;
  const auto n = static_cast<double>(frames.size());
  for (const FeatureSet* frame : frames) {
    if (settings.keep_going && !settings.keep_going()) return result;
    all.push_back(slopes(*frame, T_camera_lidar, pivot, objective, settings, scale));
    mean.gradient += all.back().gradient / n;
    mean.hessian += all.back().hessian / n;
  }
  Matrix6 scatter = Matrix6::Zero();
  for (const Slopes& frame : all) {
    const Vector6 away = frame.gradient - mean.gradient;
    scatter += away * away.transpose() / std::max(1.0, n - 1) / n;
  }
  const Matrix6 resampled = bootstrap(all, mean.gradient);

  // From gradients to parameters: a Newton step. Directions without a maximum get so little curvature that the scatter
  // fills the bounds, which are all that is known of them.
  const Eigen::SelfAdjointEigenSolver<Matrix6> curvature(-mean.hessian);
  const double least = std::sqrt(std::max(1e-24, std::max(scatter.trace(), resampled.trace())));
  const Vector6 inverse = curvature.eigenvalues().cwiseMax(least).cwiseInverse();
  const Matrix6 newton = curvature.eigenvectors() * inverse.asDiagonal() * curvature.eigenvectors().transpose();
  // A rotation about the pivot is one about the LiDAR's origin and a translation: pivot x rotation.
  Matrix6 about_origin = Matrix6::Identity();
  about_origin.block<3, 3>(3, 0) << 0, -pivot.z(), pivot.y(), pivot.z(), 0, -pivot.x(), -pivot.y(), pivot.x(), 0;
  const Matrix6 to_lidar = about_origin * scale.asDiagonal();
  const auto in_units = [&](const Matrix6& gradients) -> Matrix6 {
    return to_lidar * (newton * gradients * newton) * to_lidar.transpose();
  };
  result.covariance = in_units(scatter);
  result.bootstrap_covariance = in_units(resampled);
  const Vector6 sigma = result.sigma();
  for (int axis = 0; axis < 6; ++axis)
    result.observable[axis] = settings.free_axes[axis] && has_maximum(all, axis) && sigma[axis] < scale[axis] / 2;
  return result;
}

}  // namespace calib
