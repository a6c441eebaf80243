#pragma once

#include <Eigen/Core>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "calib/result.hpp"

namespace calib {

enum class CameraModel { rectified, plumb_bob };

/// How points in the camera's optical frame (x right, y down, z forward, metres) become pixels of an image.
/// Pixel (0, 0) is the centre of the top left pixel. Immutable: made by `make`, valid ever after.
class Camera {
 public:
  /// `intrinsics` is (fx, fy, cx, cy) in pixels; `distortion` is empty for `rectified` and (k1, k2, p1, p2, k3) or its
  /// first four for `plumb_bob`. Fails with `bad_camera` when sizes, counts or ranges are off
  /// (1 < f < 1e5, finite numbers, at most 64 Mpx).
  [[nodiscard]] static Result<Camera> make(CameraModel model, int width, int height,
                                           const std::vector<double>& intrinsics,
                                           const std::vector<double>& distortion = {});

  /// The pixel at which `p_camera` is seen, or nothing when it is not visible: behind the camera, outside the image,
  /// or outside the model's domain of validity (`plumb_bob` is valid up to the radius at which its radial polynomial
  /// stops growing; past that it folds back and would give a wrong pixel).
  [[nodiscard]] std::optional<Eigen::Vector2d> project(const Eigen::Vector3d& p_camera) const;

  /// Unit bearing (optical frame) of the pixel `uv`, or nothing where the model has no inverse there.
  [[nodiscard]] std::optional<Eigen::Vector3d> unproject(const Eigen::Vector2d& uv) const;

  [[nodiscard]] CameraModel model() const { return model_; }
  [[nodiscard]] int width() const { return width_; }
  [[nodiscard]] int height() const { return height_; }
  [[nodiscard]] double fx() const { return fx_; }
  [[nodiscard]] double fy() const { return fy_; }
  [[nodiscard]] double cx() const { return cx_; }
  [[nodiscard]] double cy() const { return cy_; }
  [[nodiscard]] const std::vector<double>& distortion() const { return distortion_; }

 private:
  Camera() = default;
  [[nodiscard]] Eigen::Vector2d distort(const Eigen::Vector2d& normalised) const;

  CameraModel model_ = CameraModel::rectified;
  int width_ = 0, height_ = 0;
  double fx_ = 0, fy_ = 0, cx_ = 0, cy_ = 0;
  std::vector<double> distortion_;
  double max_radius_squared_ = 0;  // of the undistorted, normalised point; infinite for `rectified`
};

[[nodiscard]] Result<CameraModel> parse_camera_model(std::string_view name);
[[nodiscard]] std::string_view to_string(CameraModel model);

}  // namespace calib
