#pragma once

#include <Eigen/Core>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "calib/camera_models.hpp"
#include "calib/result.hpp"

namespace calib {

/// How points in the camera's optical frame (x right, y down, z forward, metres) become pixels of an image.
/// Pixel (0, 0) is the centre of the top left pixel. Immutable: made by `make`, valid ever after.
class Camera {
 public:
  /// `intrinsics` is (fx, fy, cx, cy) in pixels; `distortion` as the model's `parameters`. Fails with `bad_camera`
  /// when sizes, counts or ranges are off (1 < f < 1e5, finite numbers, 16 x 16 pixels to 64 Mpx).
  [[nodiscard]] static Result<Camera> make(CameraModel model, int width, int height,
                                           const std::vector<double>& intrinsics,
                                           const std::vector<double>& distortion = {});

  /// The pixel at which `p_camera` is seen, or nothing when it is not visible: outside the image, outside the model's
  /// cone, or not finite. Points behind the camera (z <= 0) are visible to lenses of 180 degrees and more.
  [[nodiscard]] std::optional<Eigen::Vector2d> project(const Eigen::Vector3d& p_camera) const;

  /// Unit bearing (optical frame) of the pixel `uv`, or nothing where the model has no inverse there. Pixels outside
  /// the image are taken for what the model says of them.
  [[nodiscard]] std::optional<Eigen::Vector3d> unproject(const Eigen::Vector2d& uv) const;

  /// The same lens for the image scaled to another size, its edges kept: c' = (c + 0.5) s - 0.5. Fails as `make` does.
  [[nodiscard]] Result<Camera> resized(int width, int height) const;

  [[nodiscard]] CameraModel model() const { return model_; }
  [[nodiscard]] int width() const { return width_; }
  [[nodiscard]] int height() const { return height_; }
  [[nodiscard]] double fx() const { return fx_; }
  [[nodiscard]] double fy() const { return fy_; }
  [[nodiscard]] double cx() const { return cx_; }
  [[nodiscard]] double cy() const { return cy_; }
  [[nodiscard]] const std::vector<double>& distortion() const { return distortion_; }
  /// No visible point is further off the optical axis than this. An upper bound, at most 0.2 degrees above the truth.
  [[nodiscard]] double max_angle_rad() const { return max_angle_rad_; }

 private:
  Camera() = default;
  [[nodiscard]] double widest_angle_rad() const;

  CameraModel model_ = CameraModel::rectified;
  int width_ = 0, height_ = 0;
  double fx_ = 0, fy_ = 0, cx_ = 0, cy_ = 0;
  std::vector<double> distortion_;
  CameraLens lens_ = make_lens(CameraModel::rectified, {});
  double cone_rad_ = 0;  // half the angle of the model's cone
  double min_cosine_ = 1;
  double max_angle_rad_ = 0;
};

[[nodiscard]] Result<CameraModel> parse_camera_model(std::string_view name);
[[nodiscard]] std::string_view to_string(CameraModel model);

}  // namespace calib
