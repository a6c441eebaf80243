#include "dataset/recording.hpp"

#include "dataset/cloud_file.hpp"

namespace calib {
namespace {

Result<Image> read_camera_image(const std::filesystem::path& path, const Camera& camera, Colours colours, int bits) {
  return read_image(path, colours, std::pair(camera.width(), camera.height()), bits);
}

}  // namespace

Result<FramePair> Recording::frame(std::size_t index, Colours colours) const {
  if (index >= size())
    return fail(ErrorCode::frame_out_of_range, "frame " + std::to_string(index) + " of " + std::to_string(size()));
  if (reader_) return reader_(index, colours);
  const RecordedFrame& files = frames_.complete[index];
  auto image = read_camera_image(files.image, camera_, colours, image_bits_);
  if (!image) return propagate(image);
  auto scan = read_cloud(files.cloud, cloud_layout_);
  if (!scan) return propagate(scan);
  if (files.T_image_time_scan_time)
    for (LidarPoint& point : scan->points) {
      const Eigen::Vector3f moved =
          (*files.T_image_time_scan_time * Eigen::Vector3d(point.x_m, point.y_m, point.z_m)).cast<float>();
      point = {moved.x(), moved.y(), moved.z(), point.reflectance};
    }
  image->stamp = scan->stamp = index * std::chrono::milliseconds(100);
  FramePair pair{*std::move(image), std::nullopt, *std::move(scan)};
  if (files.right_image) {
    auto right = read_camera_image(*files.right_image, camera_, Colours::grey, image_bits_);
    if (!right) return propagate(right);
    right->stamp = pair.image.stamp;
    pair.right_image = *std::move(right);
  }
  return pair;
}

}  // namespace calib
