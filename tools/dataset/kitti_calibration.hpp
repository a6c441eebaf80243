#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include "calib/camera.hpp"
#include "calib/geometry.hpp"
#include "calib/result.hpp"

namespace calib {

/// One calibration file of KITTI or KITTI-360: lines of `key: numbers`, or numbers alone under the empty key. Lines
/// whose value is not a list of numbers (calib_time) hold none.
class KittiCalibration {
 public:
  /// Fails with `calibration_missing`.
  [[nodiscard]] static Result<KittiCalibration> read(const std::filesystem::path& path);

  /// The `Rows` x `Columns` matrix under `key`, stored row by row. Fails with `calibration_malformed`.
  template <int Rows, int Columns>
  [[nodiscard]] Result<Eigen::Matrix<double, Rows, Columns>> matrix(const std::string& key) const {
    const auto found = values_.find(key);
    if (found == values_.end() || found->second.size() != Rows * Columns ||
        !std::ranges::all_of(found->second, [](double value) { return std::isfinite(value); }))
      return fail(ErrorCode::calibration_malformed, path_.string() + " has no " + std::to_string(Rows * Columns) +
                                                        " finite numbers" + (key.empty() ? "" : " under " + key));
    Eigen::Matrix<double, Rows, Columns> matrix;
    for (int i = 0; i < Rows * Columns; ++i) matrix(i / Columns, i % Columns) = found->second[i];
    return matrix;
  }

  /// The rotation under `key`: the nearest one, as the files hold six digits. Fails with `calibration_malformed`.
  [[nodiscard]] Result<Eigen::Matrix3d> rotation(const std::string& key) const;
  /// The rigid transform in the 3 x 4 matrix under `key`. Fails with `calibration_malformed`.
  [[nodiscard]] Result<RigidTransform> transform(const std::string& key) const;

 private:
  explicit KittiCalibration(std::filesystem::path path) : path_(std::move(path)) {}
  std::filesystem::path path_;
  std::map<std::string, std::vector<double>> values_;
};

/// Of P = K [I | t]: x = K (p + t).
[[nodiscard]] Eigen::Vector3d translation_of(const Eigen::Matrix<double, 3, 4>& P);

/// A rectified camera as KITTI writes one: `S_rect_NN` and `P_rect_NN`, P = K [I | t].
struct KittiRectifiedCamera {
  Camera camera;
  Eigen::Vector3d t_m;  // K^-1 p4: from the rectified frame of camera 0 to that of this camera

  /// `number` is "00" .. "03". Fails with `calibration_malformed` or `bad_camera`.
  [[nodiscard]] static Result<KittiRectifiedCamera> read(const KittiCalibration& file, const std::string& number);
};

/// Distance from camera `number` to its right neighbour, from their P_rect; nothing when the file has no such
/// neighbour. Fails with `calibration_malformed` when it is not to the right.
[[nodiscard]] Result<std::optional<double>> kitti_baseline_m(const KittiCalibration& file, const std::string& left,
                                                             const std::string& right);

}  // namespace calib
