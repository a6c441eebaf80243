#include "calib/misalignment.hpp"

#include <string>

#include "recalibration_gates.hpp"

namespace calib {
namespace {

/// What the bootstrap does not know (standard deviation): searches from different starts end so far apart. Measured on
/// recorded streets, over 6 to 12 frames.
constexpr double own_rotation_rad = 0.05 * radians_per_degree, own_monocular_rad = 0.1 * radians_per_degree;
constexpr double own_translation_m = 0.02;
/// A mount bends more easily than it slides: a translation counts where it raises the score by so many standard errors,
/// or is itself so many standard deviations large.
constexpr double slides_sigmas = 3;

struct Found {
  SearchResult result;
  Misalignment misalignment;
};

Result<Found> found_by(Frames frames, const RigidTransform& T_camera_lidar, const SearchSettings& settings) {
  auto found = search(frames, T_camera_lidar, Method::standard, settings);
  if (!found) return propagate(found);
  if (found->ends_at_limit) return fail(ErrorCode::search_failed, found->reason);
  const Uncertainty known = uncertainty(frames, found->T_camera_lidar, found->objective, settings);
  if (settings.keep_going && !settings.keep_going()) return fail(ErrorCode::cancelled, "the search was ended");
  // As Student's distribution is wider than the normal one.
  const auto n = static_cast<double>(frames.size());
  Misalignment estimate{found->delta, known.bootstrap_covariance * ((n - 1) / (n - 3))};
  for (int axis = 0; axis < 6; ++axis) {
    const double own = axis >= 3 ? own_translation_m : settings.monocular_depth ? own_monocular_rad : own_rotation_rad;
    const double bound = axis < 3 ? settings.bounds.rotation_rad : settings.bounds.translation_m;
    estimate.covariance(axis, axis) += known.observable[axis] ? own * own : bound * bound;
  }
  return Found{*std::move(found), estimate};
}

}  // namespace

Result<Misalignment> find_misalignment(Frames frames, const RigidTransform& T_camera_lidar,
                                       const SearchSettings& settings) {
  if (frames.size() < fewest_misalignment_frames)
    return fail(ErrorCode::too_few_pairs, std::to_string(frames.size()) + " pairs, and at least " +
                                              std::to_string(fewest_misalignment_frames) +
                                              " are needed to estimate a misalignment");
  SearchSettings rotation = settings;
  rotation.free_axes = {true, true, true, false, false, false};
  auto turned = found_by(frames, T_camera_lidar, rotation);
  if (!turned) return propagate(turned);
  if (settings.monocular_depth) return turned->misalignment;
  const auto moved = found_by(frames, T_camera_lidar, settings);
  if (!moved && moved.error().code != ErrorCode::search_failed) return propagate(moved);
  if (!moved) return turned->misalignment;
  const SearchResult& all = moved->result;
  const Vector6 sigmas = moved->misalignment.delta.cwiseQuotient(moved->misalignment.sigma());
  if (sigmas.tail<3>().cwiseAbs().maxCoeff() > slides_sigmas ||
      gain(frames, turned->result.T_camera_lidar, all.T_camera_lidar, all.objective).exceeds(slides_sigmas))
    return moved->misalignment;
  Matrix6 covariance = moved->misalignment.covariance;
  covariance.diagonal() += all.delta.cwiseAbs2();
  turned->misalignment.covariance.bottomRightCorner<3, 3>() = covariance.bottomRightCorner<3, 3>();
  return turned->misalignment;
}

}  // namespace calib
