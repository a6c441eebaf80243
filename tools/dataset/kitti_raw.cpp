#include "dataset/kitti_raw.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <fstream>
#include <iterator>
#include <map>
#include <opencv2/imgcodecs.hpp>
#include <sstream>

namespace calib {
namespace {

namespace fs = std::filesystem;

/// One calibration file: lines of `key: numbers`. Lines whose value is not a list of numbers (calib_time)
/// hold none.
class CalibrationFile {
 public:
  static Result<CalibrationFile> read(const fs::path& path) {
    std::ifstream in(path);
    if (!in)
      return fail("calibration_missing",
                  path.string() + " cannot be read; a drive's calibration lies in its parent folder");
    CalibrationFile file(path);
    for (std::string line; std::getline(in, line);) {
      const auto colon = line.find(':');
      if (colon == std::string::npos) continue;
      std::istringstream numbers(line.substr(colon + 1));
      numbers.imbue(std::locale::classic());
      file.values_[line.substr(0, colon)] = {std::istream_iterator<double>(numbers), {}};
    }
    return file;
  }

  /// The `Rows` x `Columns` matrix under `key`, stored row by row.
  template <int Rows, int Columns>
  Result<Eigen::Matrix<double, Rows, Columns>> matrix(const std::string& key) const {
    const auto found = values_.find(key);
    if (found == values_.end() || found->second.size() != Rows * Columns ||
        !std::ranges::all_of(found->second, [](double value) { return std::isfinite(value); }))
      return fail("calibration_malformed", path_.string() + " has no " + std::to_string(Rows * Columns) +
                                               " finite numbers under " + key);
    Eigen::Matrix<double, Rows, Columns> matrix;
    for (int i = 0; i < Rows * Columns; ++i) matrix(i / Columns, i % Columns) = found->second[i];
    return matrix;
  }

 private:
  explicit CalibrationFile(fs::path path) : path_(std::move(path)) {}
  fs::path path_;
  std::map<std::string, std::vector<double>> values_;
};

/// The rotation nearest to `matrix`: the files hold six digits, so theirs are orthonormal to 1e-6 only.
Eigen::Matrix3d nearest_rotation(const Eigen::Matrix3d& matrix) {
  return Eigen::Quaterniond(matrix).normalized().toRotationMatrix();
}

Result<std::vector<std::string>> frame_names(const fs::path& folder, const std::string& extension) {
  std::error_code error;
  std::vector<std::string> names;
  for (const auto& entry : fs::directory_iterator(folder, error))
    if (entry.path().extension() == extension) names.push_back(entry.path().stem().string());
  if (error || names.empty())
    return fail("drive_not_found", folder.string() + " holds no " + extension + " files");
  std::ranges::sort(names);
  return names;
}

Result<Image> read_image(const fs::path& path, const Camera& camera) {
  cv::Mat grey;
  try {
    grey = cv::imread(path.string(), cv::IMREAD_GRAYSCALE);
  } catch (const cv::Exception&) {  // a damaged header; reported below like any other unreadable file
  }
  if (grey.empty()) return fail("image_unreadable", path.string() + " is missing or not an image");
  if (grey.cols != camera.width() || grey.rows != camera.height())
    return fail("image_unreadable", path.string() + " is " + std::to_string(grey.cols) + " x " +
                                        std::to_string(grey.rows) + " pixels, its calibration says " +
                                        std::to_string(camera.width()) + " x " +
                                        std::to_string(camera.height()));
  return Image{{}, grey.cols, grey.rows, {grey.begin<std::uint8_t>(), grey.end<std::uint8_t>()}};
}

Result<LidarScan> read_scan(const fs::path& path) {
  std::ifstream in(path, std::ios::binary);
  const std::vector<char> bytes{std::istreambuf_iterator<char>(in), {}};
  constexpr std::size_t bytes_per_point = 4 * sizeof(float);
  if (bytes.size() % bytes_per_point != 0)
    return fail("cloud_unreadable", path.string() + " does not hold whole points of four 32-bit floats");
  LidarScan scan;
  for (std::size_t i = 0; i < bytes.size(); i += bytes_per_point) {
    LidarPoint point;
    std::memcpy(&point, bytes.data() + i, bytes_per_point);
    if (!(std::hypot(point.x_m, point.y_m, point.z_m) <= 500.f))
      continue;  // written so that NaN is left out too
    scan.points.push_back(point);
  }
  if (scan.points.empty()) return fail("cloud_unreadable", path.string() + " is missing or holds no point");
  return scan;
}

/// A camera's projection with a translation of its own, P = K [I | t]: x = K (p + t).
Eigen::Vector3d projection_translation(const Eigen::Matrix<double, 3, 4>& P) {
  return P.leftCols<3>().inverse() * P.col(3);
}

}  // namespace

Result<KittiRawDrive> KittiRawDrive::open(const fs::path& folder) {
  const fs::path drive = (folder.has_filename() ? folder : folder.parent_path());
  if (!fs::is_directory(drive)) return fail("drive_not_found", drive.string() + " is not a folder");
  const fs::path date = fs::absolute(drive).parent_path();
  const auto cameras = CalibrationFile::read(date / "calib_cam_to_cam.txt");
  if (!cameras) return tl::unexpected(cameras.error());
  const auto lidar = CalibrationFile::read(date / "calib_velo_to_cam.txt");
  if (!lidar) return tl::unexpected(lidar.error());

  const auto size = cameras->matrix<2, 1>("S_rect_02");
  const auto R_rect = cameras->matrix<3, 3>("R_rect_00");
  const auto P_left = cameras->matrix<3, 4>("P_rect_02");
  const auto P_right = cameras->matrix<3, 4>("P_rect_03");
  const auto R_camera0_lidar = lidar->matrix<3, 3>("R");
  const auto t_camera0_lidar = lidar->matrix<3, 1>("T");
  if (!size) return tl::unexpected(size.error());
  for (const auto* matrix : {&P_left, &P_right})
    if (!*matrix) return tl::unexpected(matrix->error());
  for (const auto* rotation : {&R_rect, &R_camera0_lidar}) {
    if (!*rotation) return tl::unexpected(rotation->error());
    if (((**rotation) * (*rotation)->transpose() - Eigen::Matrix3d::Identity()).norm() > 1e-3 ||
        (*rotation)->determinant() < 0)
      return fail("calibration_malformed", "R_rect_00 or R of " + date.string() + " is not a rotation");
  }
  if (!t_camera0_lidar) return tl::unexpected(t_camera0_lidar.error());

  auto camera =
      Camera::make(CameraModel::rectified, static_cast<int>((*size)(0)), static_cast<int>((*size)(1)),
                   {(*P_left)(0, 0), (*P_left)(1, 1), (*P_left)(0, 2), (*P_left)(1, 2)});
  if (!camera) return tl::unexpected(camera.error());

  KittiRawDrive result(drive, *std::move(camera));
  const Eigen::Vector3d t_left = projection_translation(*P_left);
  result.baseline_m_ = (t_left - projection_translation(*P_right)).x();
  if (!(result.baseline_m_ > 0))
    return fail("calibration_malformed", "image_03 is not to the right of image_02");

  RigidTransform T_camera0_lidar = RigidTransform::Identity();
  T_camera0_lidar.linear() = nearest_rotation(*R_camera0_lidar);
  T_camera0_lidar.translation() = *t_camera0_lidar;
  result.T_camera_lidar_.linear() = nearest_rotation(*R_rect);
  result.T_camera_lidar_.translation() = t_left;
  result.T_camera_lidar_ = result.T_camera_lidar_ * T_camera0_lidar;

  auto names = frame_names(drive / "image_02/data", ".png");
  if (!names) return tl::unexpected(names.error());
  const auto right = frame_names(drive / "image_03/data", ".png");
  if (!right) return tl::unexpected(right.error());
  const auto scans = frame_names(drive / "velodyne_points/data", ".bin");
  if (!scans) return tl::unexpected(scans.error());
  if (*names != *right || *names != *scans)
    return fail("frame_mismatch", drive.string() + " does not have the same frames in image_02 (" +
                                      std::to_string(names->size()) + "), image_03 (" +
                                      std::to_string(right->size()) + ") and velodyne_points (" +
                                      std::to_string(scans->size()) + ")");
  result.frame_names_ = *std::move(names);
  return result;
}

Result<FramePair> KittiRawDrive::frame(std::size_t index) const {
  if (index >= size())
    return fail("frame_out_of_range", "frame " + std::to_string(index) + " of " + std::to_string(size()));
  const std::string& name = frame_names_[index];
  auto left = read_image(drive_ / "image_02/data" / (name + ".png"), camera_);
  if (!left) return tl::unexpected(left.error());
  auto right = read_image(drive_ / "image_03/data" / (name + ".png"), camera_);
  if (!right) return tl::unexpected(right.error());
  auto scan = read_scan(drive_ / "velodyne_points/data" / (name + ".bin"));
  if (!scan) return tl::unexpected(scan.error());
  left->stamp = right->stamp = scan->stamp = index * std::chrono::milliseconds(100);
  return FramePair{*std::move(left), *std::move(right), *std::move(scan)};
}

}  // namespace calib
