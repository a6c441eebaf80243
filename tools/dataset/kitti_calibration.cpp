#include "dataset/kitti_calibration.hpp"

#include <Eigen/LU>
#include <iterator>
#include <sstream>

#include "calib/file.hpp"

namespace calib {
namespace {

/// Within what six written digits allow.
bool is_rotation(const Eigen::Matrix3d& matrix) {
  return (matrix * matrix.transpose() - Eigen::Matrix3d::Identity()).norm() < 1e-3 && matrix.determinant() > 0;
}

}  // namespace

Eigen::Vector3d translation_of(const Eigen::Matrix<double, 3, 4>& P) { return P.leftCols<3>().inverse() * P.col(3); }

Result<KittiCalibration> KittiCalibration::read(const std::filesystem::path& path) {
  constexpr std::uint64_t most_bytes = 1 << 20;
  const auto text = read_regular_file(path, most_bytes);
  if (!text)
    return fail(ErrorCode::calibration_missing, text.error().context + "; it comes with the data set's calibration");
  std::istringstream in(*text);
  KittiCalibration file(path);
  for (std::string line; std::getline(in, line);) {
    const auto colon = line.find(':');
    const std::string key = colon == std::string::npos ? "" : line.substr(0, colon);
    std::istringstream numbers(colon == std::string::npos ? line : line.substr(colon + 1));
    numbers.imbue(std::locale::classic());
    if (std::vector<double> values{std::istream_iterator<double>(numbers), {}}; !values.empty())
      file.values_[key] = std::move(values);
  }
  return file;
}

Result<Eigen::Matrix3d> KittiCalibration::rotation(const std::string& key) const {
  const auto R = matrix<3, 3>(key);
  if (!R) return R;
  if (!is_rotation(*R))
    return fail(ErrorCode::calibration_malformed, key + " of " + path_.string() + " is not a rotation");
  return Eigen::Quaterniond(*R).normalized().toRotationMatrix();
}

Result<RigidTransform> KittiCalibration::transform(const std::string& key) const {
  const auto T = matrix<3, 4>(key);
  if (!T) return propagate(T);
  if (!is_rotation(T->leftCols<3>()))
    return fail(ErrorCode::calibration_malformed,
                path_.string() + " holds no rigid transform" + (key.empty() ? "" : " under " + key));
  RigidTransform result = RigidTransform::Identity();
  result.linear() = Eigen::Quaterniond(Eigen::Matrix3d(T->leftCols<3>())).normalized().toRotationMatrix();
  result.translation() = T->col(3);
  return result;
}

Result<KittiRectifiedCamera> KittiRectifiedCamera::read(const KittiCalibration& file, const std::string& number) {
  const auto size = file.matrix<2, 1>("S_rect_" + number);
  if (!size) return propagate(size);
  const auto P = file.matrix<3, 4>("P_rect_" + number);
  if (!P) return propagate(P);
  // Beyond that no image is, and no int either.
  if (size->minCoeff() < 1 || size->maxCoeff() > 1e5)
    return fail(ErrorCode::calibration_malformed, "S_rect_" + number + " is not the size of an image");
  auto camera = Camera::make(CameraModel::rectified, static_cast<int>((*size)(0)), static_cast<int>((*size)(1)),
                             {(*P)(0, 0), (*P)(1, 1), (*P)(0, 2), (*P)(1, 2)});
  if (!camera) return propagate(camera);
  return KittiRectifiedCamera{*std::move(camera), translation_of(*P)};
}

Result<std::optional<double>> kitti_baseline_m(const KittiCalibration& file, const std::string& left,
                                               const std::string& right) {
  const auto P_left = file.matrix<3, 4>("P_rect_" + left), P_right = file.matrix<3, 4>("P_rect_" + right);
  if (!P_left || !P_right) return std::nullopt;
  const double baseline_m = (translation_of(*P_left) - translation_of(*P_right)).x();
  if (!(baseline_m > 0))
    return fail(ErrorCode::calibration_malformed, "image_" + right + " is not to the right of image_" + left);
  return baseline_m;
}

}  // namespace calib
