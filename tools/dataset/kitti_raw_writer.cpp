#include "dataset/kitti_raw_writer.hpp"

#include <iomanip>
#include <sstream>

#include "calib/file.hpp"
#include "dataset/cloud_file.hpp"
#include "dataset/image_file.hpp"

namespace calib {
namespace {

namespace fs = std::filesystem;

tl::unexpected<Error> write_failed(const fs::path& path) {
  return fail(ErrorCode::write_failed, path.string() + " cannot be written");
}

/// `key: numbers`, row by row, with every digit that a double has.
void write_matrix(std::ostream& out, const char* key, const Eigen::MatrixXd& matrix) {
  out << key << ':';
  for (int row = 0; row < matrix.rows(); ++row)
    for (int column = 0; column < matrix.cols(); ++column) out << ' ' << matrix(row, column);
  out << '\n';
}

}  // namespace

Result<KittiRawWriter> KittiRawWriter::create(const fs::path& drive, const Camera& camera, double baseline_m,
                                              const RigidTransform& T_camera_lidar) {
  std::error_code error;
  for (const char* folder : {"image_02/data", "image_03/data", "velodyne_points/data"})
    if (fs::create_directories(drive / folder, error); error) return write_failed(drive / folder);

  const fs::path date = fs::absolute(drive, error).parent_path();
  std::ostringstream cameras;
  cameras.imbue(std::locale::classic());
  cameras << std::setprecision(17);
  Eigen::Matrix<double, 3, 4> P = Eigen::Matrix<double, 3, 4>::Zero();
  P << camera.fx(), 0, camera.cx(), 0, 0, camera.fy(), camera.cy(), 0, 0, 0, 1, 0;
  write_matrix(cameras, "R_rect_00", Eigen::Matrix3d::Identity());
  write_matrix(cameras, "S_rect_02", Eigen::Vector2d(camera.width(), camera.height()));
  write_matrix(cameras, "P_rect_02", P);
  P(0, 3) = -camera.fx() * baseline_m;
  write_matrix(cameras, "S_rect_03", Eigen::Vector2d(camera.width(), camera.height()));
  write_matrix(cameras, "P_rect_03", P);

  std::ostringstream lidar;
  lidar.imbue(std::locale::classic());
  lidar << std::setprecision(17);
  write_matrix(lidar, "R", T_camera_lidar.linear());
  write_matrix(lidar, "T", T_camera_lidar.translation());
  return replace_file(date / "calib_cam_to_cam.txt", cameras.str())
      .and_then([&] { return replace_file(date / "calib_velo_to_cam.txt", lidar.str()); })
      .map([&] { return KittiRawWriter(drive); });
}

Result<void> KittiRawWriter::append(const FramePair& pair) {
  std::string name = std::to_string(count_);
  name.insert(0, 10 - name.size(), '0');
  const auto left = write_image(drive_ / "image_02/data" / (name + ".png"), pair.image);
  if (!left) return left;
  const auto right = write_image(drive_ / "image_03/data" / (name + ".png"), pair.right_image.value());
  if (!right) return right;
  const auto scan = write_cloud(drive_ / "velodyne_points/data" / (name + ".bin"), pair.scan);
  if (!scan) return scan;
  ++count_;
  return {};
}

}  // namespace calib
