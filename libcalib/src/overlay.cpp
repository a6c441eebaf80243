#include "calib/overlay.hpp"

#include <algorithm>
#include <cctype>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <utility>

#include "calib/file.hpp"
#include "calib/image_codec.hpp"

namespace calib {
namespace {

/// By the extension of `file`, in either case.
std::optional<Compression> compression_for(const std::filesystem::path& file) {
  std::string extension = file.extension().string();
  for (char& letter : extension) letter = static_cast<char>(std::tolower(static_cast<unsigned char>(letter)));
  if (extension == ".png") return Compression::png;
  if (extension == ".jpg" || extension == ".jpeg" || extension == ".jpe") return Compression::jpeg;
  return std::nullopt;
}

/// From far (blue) to near (red), in RGB.
cv::Mat colour_table() {
  cv::Mat shades(1, 256, CV_8UC1), colours;
  for (int i = 0; i < 256; ++i) shades.at<std::uint8_t>(i) = static_cast<std::uint8_t>(i);
  cv::applyColorMap(shades, colours, cv::COLORMAP_TURBO);
  cv::cvtColor(colours, colours, cv::COLOR_BGR2RGB);
  return colours;
}

cv::Mat points_on_image(const FramePair& pair, const Camera& camera, const RigidTransform& T_camera_lidar,
                        const cv::Mat& colours) {
  const cv::Mat grey(pair.image.height, pair.image.width, CV_8UC1,
                     const_cast<std::uint8_t*>(pair.image.pixels.data()));  // read only
  cv::Mat picture;
  cv::cvtColor(grey, picture, cv::COLOR_GRAY2RGB);
  // One dot in each cell, so that the image is seen between them, however dense the scan is.
  constexpr int cell = 4;
  cv::Mat_<std::uint8_t> taken(picture.rows / cell + 1, picture.cols / cell + 1, std::uint8_t{0});
  const cv::Rect inside({0, 0}, picture.size());  // the image may be smaller than its camera should be
  for (const LidarPoint& point : pair.scan.points) {
    const Eigen::Vector3d p_lidar(point.x_m, point.y_m, point.z_m);
    const auto uv = camera.project(T_camera_lidar * p_lidar);
    if (!uv) continue;
    const cv::Point pixel(cvRound(uv->x()), cvRound(uv->y()));
    if (!inside.contains(pixel) || std::exchange(taken(pixel / cell), 1)) continue;
    const int shade = static_cast<int>(250 * std::exp(-p_lidar.norm() / 25));
    cv::circle(picture, pixel, 1, colours.at<cv::Vec3b>(shade), cv::FILLED);
  }
  return picture;
}

/// By rank, since depth may have any scale.
cv::Mat depth_in_colours(const DepthMap& depth, const cv::Mat& colours) {
  cv::Mat picture(depth.height, depth.width, CV_8UC3, cv::Scalar::all(0));
  std::vector<float> sorted;
  std::ranges::copy_if(depth.inverse_depth, std::back_inserter(sorted), [](float d) { return d > DepthMap::no_depth; });
  std::ranges::sort(sorted);
  for (std::size_t i = 0; i < depth.inverse_depth.size(); ++i) {
    const float value = depth.inverse_depth[i];
    if (!(value > DepthMap::no_depth)) continue;
    const auto rank = std::ranges::lower_bound(sorted, value) - sorted.begin();
    picture.at<cv::Vec3b>(static_cast<int>(i) / depth.width, static_cast<int>(i) % depth.width) =
        colours.at<cv::Vec3b>(static_cast<int>(250 * rank / static_cast<std::ptrdiff_t>(sorted.size())));
  }
  return picture;
}

}  // namespace

Result<void> write_overlay(const std::filesystem::path& file, const FramePair& pair, const Camera& camera,
                           const RigidTransform& T_camera_lidar, const DepthMap* depth) {
  const auto compression = compression_for(file);
  if (!compression)
    return fail(ErrorCode::write_failed, file.string() + " cannot be written: its extension is neither .png nor .jpg");
  try {
    const cv::Mat colours = colour_table();
    cv::Mat picture = points_on_image(pair, camera, T_camera_lidar, colours);
    if (depth != nullptr && depth->width == picture.cols)
      cv::vconcat(picture, depth_in_colours(*depth, colours), picture);
    const auto encoded = encode_pixels({picture.data, picture.total() * picture.elemSize()},
                                       {picture.cols, picture.rows, picture.channels()}, *compression);
    if (!encoded)
      return fail(ErrorCode::write_failed, file.string() + " cannot be written: " + encoded.error().context);
    return replace_file(file, *encoded);
  } catch (const cv::Exception& exception) {
    return fail(ErrorCode::write_failed, file.string() + " cannot be written: " + exception.err);
  }
}

}  // namespace calib
