#include "extrinsic_formats/plausibility.hpp"

#include <cmath>
#include <numbers>

#include "calib/extrinsic_check.hpp"

namespace calib::formats {
namespace {

/// What a LiDAR sees that stands in the middle of a round wall: no real scan is at hand.
LidarScan round_scan() {
  constexpr double range_m = 20;
  LidarScan scan;
  for (int azimuth = 0; azimuth < 360; azimuth += 2)
    for (int elevation = -24; elevation <= 16; elevation += 2) {
      const double a = azimuth * radians_per_degree, e = elevation * radians_per_degree;
      scan.points.push_back({static_cast<float>(range_m * std::cos(a) * std::cos(e)),
                             static_cast<float>(range_m * std::sin(a) * std::cos(e)),
                             static_cast<float>(range_m * std::sin(e)), 0});
    }
  return scan;
}

ExtrinsicOpinion opinion_of(const RigidTransform& T_camera_lidar) {
  static const LidarScan scan = round_scan();
  static const Camera camera = *Camera::make(CameraModel::rectified, 1280, 720, {640, 640, 639.5, 359.5});
  return examine_extrinsic(camera, T_camera_lidar, scan);
}

std::string words_for(const Reading& given, const Reading& better) {
  const std::string axes = better.axes == CameraAxes::body
                               ? "the camera frame has the axes of a body (x forward, y left, z up)"
                               : "the camera frame has optical axes (x right, y down, z forward)";
  const std::string inverse = better.inverse ? "it is the inverse" : "it is no inverse";
  if (given.axes == better.axes)
    return better.inverse ? "it looks like its inverse" : "it looks as if it were no inverse";
  if (given.inverse == better.inverse) return "it looks as if " + axes;
  return "it looks as if " + inverse + " and " + axes;
}

}  // namespace

RigidTransform read_as(const RigidTransform& T, const Reading& reading) {
  const RigidTransform directed = reading.inverse ? T.inverse() : T;
  return reading.axes == CameraAxes::body ? T_optical_body() * directed : directed;
}

std::optional<Doubt> doubt_about(const RigidTransform& T, const Reading& reading) {
  const ExtrinsicOpinion given = opinion_of(read_as(T, reading));
  if (given.plausible() && given.upright) return std::nullopt;
  const CameraAxes other = reading.axes == CameraAxes::body ? CameraAxes::optical : CameraAxes::body;
  for (const Reading& better :
       {Reading{!reading.inverse, reading.axes}, Reading{reading.inverse, other}, Reading{!reading.inverse, other}}) {
    const ExtrinsicOpinion opinion = opinion_of(read_as(T, better));
    if (opinion.plausible() && opinion.upright) return Doubt{words_for(reading, better), better};
  }
  if (given.plausible()) return std::nullopt;
  if (given.likely) return Doubt{std::string(given.likely->words), std::nullopt};
  return Doubt{"no point of a LiDAR around it would be in view", std::nullopt};
}

}  // namespace calib::formats
