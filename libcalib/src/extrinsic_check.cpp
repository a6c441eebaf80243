#include "calib/extrinsic_check.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numbers>

namespace calib {
namespace {

constexpr double degrees_per_radian = 1 / radians_per_degree;
/// A rank correlation of depth from which it speaks for an extrinsic, if other things do.
constexpr double not_contradicting = 0.5;

/// Another reading of the given numbers, and how readily it is believed.
struct Candidate {
  ExtrinsicReading reading;
  /// By how much rank correlation a later candidate must be better.
  double lead = 0.003;
  /// Whether having the points in view speaks for it.
  bool judged_by_view = true;
};

struct View {
  std::size_t points;  // in view
  bool upright;        // the LiDAR's z axis points up in the image, within 45 degrees
};

View view_of(const Camera& camera, const RigidTransform& T_camera_lidar, const LidarScan& scan) {
  View view{0, -T_camera_lidar.linear()(1, 2) > 0.7};
  for (const LidarPoint& point : scan.points)
    view.points +=
        camera.project(T_camera_lidar * Eigen::Vector3d(point.x_m, point.y_m, point.z_m)).has_value() ? 1 : 0;
  return view;
}

bool sees_nothing(const View& view, const LidarScan& scan) { return view.points * 200 < scan.points.size(); }

RigidTransform with_rotation(RigidTransform T, const Eigen::Matrix3d& R) {
  T.linear() = R;
  return T;
}

/// A rotation of less than pi degrees per axis can have come from angles in radians that were taken for degrees.
void add_radians_as_degrees(const RigidTransform& T, std::vector<Candidate>& candidates) {
  const Eigen::AngleAxisd turn(T.linear());
  if (turn.angle() > std::sqrt(3) * std::numbers::pi * radians_per_degree) return;
  const auto add = [&](const RigidTransform& reading, std::string_view words) {
    // Few rotations become a camera that sees the same when they are multiplied by 57.
    candidates.push_back({.reading = {"radians_as_degrees", words, reading}, .lead = 0.05});
  };
  const auto scaled = [](const RigidTransform& from) {
    return with_rotation(from, rotation_from_rpy(roll_pitch_yaw_rad(from.linear()) * degrees_per_radian));
  };
  add(scaled(T), "its roll, pitch and yaw look like radians that were taken for degrees");
  add(scaled(T.inverse()).inverse(),
      "the roll, pitch and yaw of its inverse, T_lidar_camera, look like radians that were taken for degrees");
  add(with_rotation(T, Eigen::AngleAxisd(turn.angle() * degrees_per_radian, turn.axis()).toRotationMatrix()),
      "its rotation vector looks like radians that were taken for degrees");
}

/// In the order in which they are believed when they fit about as well.
std::vector<Candidate> other_readings(const RigidTransform& T) {
  RigidTransform T_optical_body = RigidTransform::Identity();
  T_optical_body.linear() << 0, -1, 0, 0, 0, -1, 1, 0, 0;
  const Eigen::Quaterniond q(T.linear());
  std::vector<Candidate> candidates;
  add_radians_as_degrees(T, candidates);
  candidates.push_back({.reading = {"inverse", "it looks like the inverse, T_lidar_camera", T.inverse()}});
  candidates.push_back({.reading = {"body_frame",
                                    "its camera frame looks like the body frame (x forward, y left, z up) instead of "
                                    "the optical frame (x right, y down, z forward)",
                                    T_optical_body * T}});
  candidates.push_back({.reading = {"inverse_body_frame",
                                    "it looks like the inverse, T_lidar_camera, with the camera's body frame (x "
                                    "forward, y left, z up) instead of the optical frame",
                                    T_optical_body * T.inverse()}});
  // This reading sets a camera upright that is mounted upside down, so the view cannot judge it.
  candidates.push_back(
      {.reading = {"quaternion_wxyz", "its quaternion looks as if it were in the order w, x, y, z",
                   with_rotation(T, Eigen::Quaterniond(q.x(), q.y(), q.z(), q.w()).toRotationMatrix())},
       .judged_by_view = false});
  return candidates;
}

struct Scene {
  const Camera& camera;
  const LidarScan& scan;
  const DepthMap* depth;

  [[nodiscard]] std::optional<DepthAgreement> agreement(const RigidTransform& T_camera_lidar) const {
    return depth ? depth_agreement(*depth, camera, T_camera_lidar, scan) : std::nullopt;
  }
};

/// The reading that depth agrees with best, when that is well and clearly better than with the given one; a camera on
/// its side needs less to be doubted.
void find_by_depth(const Scene& scene, const std::vector<Candidate>& candidates, ExtrinsicOpinion& opinion) {
  constexpr double good = 0.75;
  const double clearly = opinion.upright ? 0.2 : 0.05;
  double best = good;
  if (opinion.agreement) best = std::max(best, opinion.agreement->rank_correlation + clearly);
  for (const auto& [reading, lead, judged_by_view] : candidates) {
    const auto agreement = scene.agreement(reading.T_camera_lidar);
    if (!agreement || agreement->rank_correlation < best) continue;
    opinion.likely = reading, opinion.likely_agreement = agreement;
    best = agreement->rank_correlation + lead;
  }
}

/// The reading that sets the camera upright and sees the most, when that is about as much as with the given one: with a
/// wide lens a wrong direction may see a few points more.
void find_by_view(const Scene& scene, const std::vector<Candidate>& candidates, ExtrinsicOpinion& opinion) {
  const ExtrinsicReading* best = nullptr;
  std::size_t most = 0;
  for (const auto& [reading, lead, judged_by_view] : candidates) {
    if (!judged_by_view) continue;
    const View view = view_of(scene.camera, reading.T_camera_lidar, scene.scan);
    if (!view.upright || sees_nothing(view, scene.scan) || 5 * view.points < 6 * most) continue;
    best = &reading, most = view.points;
  }
  if (!best || 10 * most <= 7 * opinion.points_in_view) return;
  opinion.likely_agreement = scene.agreement(best->T_camera_lidar);
  const bool contradicted =
      scene.depth && !(opinion.likely_agreement && opinion.likely_agreement->rank_correlation > not_contradicting);
  if (!contradicted) opinion.likely = *best;
}

}  // namespace

ExtrinsicOpinion examine_extrinsic(const Camera& camera, const RigidTransform& T_camera_lidar, const LidarScan& scan,
                                   const DepthMap* depth) {
  const Scene scene{camera, scan, depth};
  const View given = view_of(camera, T_camera_lidar, scan);
  ExtrinsicOpinion opinion{.points_in_view = given.points,
                           .sees_nothing = sees_nothing(given, scan),
                           .upright = given.upright,
                           .agreement = scene.agreement(T_camera_lidar),
                           .likely = {},
                           .likely_agreement = {}};
  const auto candidates = other_readings(T_camera_lidar);
  if (depth) find_by_depth(scene, candidates, opinion);
  const bool agrees = opinion.agreement && opinion.agreement->rank_correlation > not_contradicting;
  if (!opinion.likely && !agrees && (opinion.sees_nothing || !opinion.upright))
    find_by_view(scene, candidates, opinion);
  return opinion;
}

Result<void> check_extrinsic(const Camera& camera, const RigidTransform& T_camera_lidar, const LidarScan& scan) {
  const ExtrinsicOpinion opinion = examine_extrinsic(camera, T_camera_lidar, scan);
  if (opinion.plausible()) return {};
  return fail(ErrorCode::extrinsic_implausible,
              fmt::format("T_camera_lidar brings {} of {} points into the image{}{}", opinion.points_in_view,
                          scan.points.size(), opinion.upright ? "" : " and the camera on its side",
                          opinion.likely ? ": " + std::string(opinion.likely->words) : ""));
}

}  // namespace calib
