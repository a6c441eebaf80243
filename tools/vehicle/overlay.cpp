#include "vehicle/overlay.hpp"

#include <cmath>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

namespace calib::vehicle {

Result<void> write_overlay(const std::filesystem::path& file, const FramePair& pair, const Camera& camera,
                           const RigidTransform& T_camera_lidar) {
  const cv::Mat grey(pair.image.height, pair.image.width, CV_8UC1,
                     const_cast<std::uint8_t*>(pair.image.pixels.data()));
  cv::Mat picture, shades(1, 256, CV_8UC1), colours;
  cv::cvtColor(grey, picture, cv::COLOR_GRAY2BGR);
  for (int i = 0; i < 256; ++i) shades.at<std::uint8_t>(i) = static_cast<std::uint8_t>(i);
  cv::applyColorMap(shades, colours, cv::COLORMAP_TURBO);
  for (const LidarPoint& point : pair.scan.points) {
    const Eigen::Vector3d p_lidar(point.x_m, point.y_m, point.z_m);
    const auto uv = camera.project(T_camera_lidar * p_lidar);
    if (!uv) continue;
    const int shade = static_cast<int>(250 * std::exp(-p_lidar.norm() / 25));
    cv::circle(picture, {cvRound(uv->x()), cvRound(uv->y())}, 1, colours.at<cv::Vec3b>(shade), cv::FILLED);
  }
  try {
    if (cv::imwrite(file.string(), picture)) return {};
  } catch (const cv::Exception&) {  // an extension that is no picture's; reported below
  }
  return fail("write_failed",
              file.string() + " cannot be written; its extension says which kind of picture, such as .png");
}

}  // namespace calib::vehicle
