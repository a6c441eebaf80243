#include "stereo_rectification.hpp"

#include <algorithm>
#include <cmath>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>

namespace calib {
namespace {

/// A pinhole's picture of more than this to each side of its axis is mostly stretched margin.
const double widest = std::tan(50 * radians_per_degree);
const double least_agreement = std::cos(30 * radians_per_degree);

/// Pixels per radian about the lens's axis, which a cropped picture need not show.
double resolution(const Camera& camera) {
  const auto bearing = [&](double x, double y) {
    return camera.unproject({camera.cx() + x, camera.cy() + y}).value_or(Eigen::Vector3d::UnitZ());
  };
  const double across = (bearing(1, 0) - bearing(-1, 0)).norm(), down = (bearing(0, 1) - bearing(0, -1)).norm();
  return 4 / (across + down);
}

}  // namespace

Result<StereoRectification> StereoRectification::make(const Camera& left, const RightCamera& right) {
  const Eigen::Matrix3d R_left_right = right.T_right_left.linear().transpose();
  const Eigen::Vector3d right_in_left = -R_left_right * right.T_right_left.translation();
  StereoRectification made;
  made.baseline_m_ = right_in_left.norm();
  if (!(made.baseline_m_ >= least_baseline_m && made.baseline_m_ <= most_baseline_m))
    return fail(ErrorCode::bad_camera,
                "the cameras are " + std::to_string(made.baseline_m_) +
                    " m from each other; 0.001 .. 10 m are possible (T_right_left is in metres)");
  // The baseline is the new x axis, and the new z axis lies between the two old ones.
  const Eigen::Vector3d x = right_in_left / made.baseline_m_, right_axis = R_left_right.col(2);
  const Eigen::Vector3d between = Eigen::Vector3d::UnitZ() + right_axis;
  const Eigen::Vector3d z = (between - x * x.dot(between)).normalized(), y = z.cross(x);
  if (!(right_axis.z() >= least_agreement))
    return fail(ErrorCode::bad_camera,
                "the cameras of a stereo pair look the same way to 30 degrees; correct T_right_left");
  if (!(x.x() >= least_agreement && z.z() >= least_agreement))
    return fail(ErrorCode::bad_camera,
                "the right camera is not to the right of the left one; T_right_left maps points of the left camera's "
                "frame into the right one's, so its first number is negative: have left and right changed places?");
  Eigen::Matrix3d R_rectified_left;
  R_rectified_left << x.transpose(), y.transpose(), z.transpose();

  Eigen::Vector2d least = Eigen::Vector2d::Constant(widest), most = -least;
  for (int v = 0; v < left.height(); ++v)
    for (int u = 0; u < left.width(); u += v % 8 == 0 ? 1 : left.width() - 1)  // every eighth row, and the sides
      if (const auto bearing = left.unproject(Eigen::Vector2d(u, v))) {
        const Eigen::Vector3d turned = R_rectified_left * *bearing;
        if (turned.z() <= 1e-3) continue;
        const Eigen::Vector2d place = (turned.head<2>() / turned.z()).cwiseMax(-widest).cwiseMin(widest);
        least = least.cwiseMin(place);
        most = most.cwiseMax(place);
      }
  made.focal_ = resolution(left);
  const Eigen::Vector2d size = made.focal_ * (most - least);
  if (!(size.minCoeff() >= 16 && size.prod() <= 4.0 * left.width() * left.height()))
    return fail(ErrorCode::bad_camera,
                "the left camera's picture cannot be rectified; correct its model and intrinsics");
  made.width_ = static_cast<int>(std::ceil(size.x()));
  made.height_ = static_cast<int>(std::ceil(size.y()));
  made.cx_ = -made.focal_ * least.x();
  made.cy_ = -made.focal_ * least.y();
  made.left_ = made.map_of(left, R_rectified_left);
  made.right_ = made.map_of(right.camera, R_rectified_left * R_left_right);
  made.place_left_pixels(left, R_rectified_left);
  return made;
}

StereoRectification::Map StereoRectification::map_of(const Camera& camera,
                                                     const Eigen::Matrix3d& R_rectified_camera) const {
  cv::Mat from(height_, width_, CV_32FC2);
  Map map;
  map.seen.create(height_, width_, CV_8UC1);
  for (int v = 0; v < height_; ++v)
    for (int u = 0; u < width_; ++u) {
      const Eigen::Vector3d bearing((u - cx_) / focal_, (v - cy_) / focal_, 1);
      const auto uv = camera.project(R_rectified_camera.transpose() * bearing);
      map.seen.at<std::uint8_t>(v, u) = uv.has_value();
      from.at<cv::Vec2f>(v, u) =
          uv ? cv::Vec2f(static_cast<float>(uv->x()), static_cast<float>(uv->y())) : cv::Vec2f(-1, -1);
    }
  cv::convertMaps(from, {}, map.place, map.fraction, CV_16SC2);
  return map;
}

void StereoRectification::place_left_pixels(const Camera& left, const Eigen::Matrix3d& R_rectified_left) {
  places_.resize(static_cast<std::size_t>(left.width()) * left.height());
  for (int v = 0; v < left.height(); ++v)
    for (int u = 0; u < left.width(); ++u) {
      const auto bearing = left.unproject(Eigen::Vector2d(u, v));
      if (!bearing || bearing->z() <= 0) continue;
      const Eigen::Vector3d turned = R_rectified_left * *bearing;
      if (turned.z() <= 1e-3) continue;
      const double x = std::floor(focal_ * turned.x() / turned.z() + cx_ + 0.5),
                   y = std::floor(focal_ * turned.y() / turned.z() + cy_ + 0.5);
      if (!(x >= 0 && y >= 0 && x < width_ && y < height_)) continue;
      // The same point is turned.z() away along one axis, and bearing.z() along the other.
      places_[static_cast<std::size_t>(v) * left.width() + u] = {static_cast<std::int32_t>(y * width_ + x),
                                                                 static_cast<float>(turned.z() / bearing->z())};
    }
}

cv::Mat StereoRectification::warp(const cv::Mat& image, const Map& map) {
  cv::Mat rectified;
  cv::remap(image, rectified, map.place, map.fraction, cv::INTER_LINEAR);
  return rectified;
}

void StereoRectification::look_up(const cv::Mat& disparity, std::vector<float>& inverse_depth) const {
  const auto per_unit = static_cast<float>(1.0 / (int{cv::StereoMatcher::DISP_SCALE} * focal_times_baseline()));
  constexpr int half_a_pixel = cv::StereoMatcher::DISP_SCALE / 2;
  const auto depth_at = [&](const Place& place) {
    if (place.pixel < 0) return DepthMap::no_depth;
    const int v = place.pixel / width_, u = place.pixel % width_;
    const int found = disparity.at<std::int16_t>(v, u);
    if (found <= half_a_pixel) return DepthMap::no_depth;
    const int partner = u - (found + half_a_pixel) / cv::StereoMatcher::DISP_SCALE;
    const bool seen =
        partner >= 0 && left_.seen.at<std::uint8_t>(v, u) != 0 && right_.seen.at<std::uint8_t>(v, partner) != 0;
    return seen ? static_cast<float>(found) * per_unit * place.scale : DepthMap::no_depth;
  };
  inverse_depth.resize(places_.size());
  std::ranges::transform(places_, inverse_depth.begin(), depth_at);
}

}  // namespace calib
