#pragma once

#include <Eigen/Core>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "calib/result.hpp"

namespace calib {

/// How a lens bends rays, by the name that configuration, ROS and records use. A pixel is f m + c, where m is, for the
/// point p = (x, y, z) with norm d and for n = (x, y) / z:
///
// clang-format off
/// | model               | distortion, in order | m                                            | source           |
/// |---------------------|----------------------|----------------------------------------------|------------------|
/// | rectified           | none                 | n                                            |                  |
/// | plumb_bob           | k1 k2 p1 p2 [k3]     | B(n), B: Brown's polynomial                  | OpenCV           |
/// | rational_polynomial | k1 k2 p1 p2 k3 .. k6 | B(n), B with a quotient of polynomials       | OpenCV           |
/// | equidistant         | k1 k2 k3 k4          | t (1 + k1 t^2 + .. + k4 t^8) along (x, y),   | Kannala & Brandt |
/// |                     |                      | t: angle off the optical axis                | 2006, OpenCV     |
/// | double_sphere       | xi alpha             | (x, y) / (alpha e + (1 - alpha) (xi d + z)), | Usenko et al.    |
/// |                     |                      | e^2 = x^2 + y^2 + (xi d + z)^2               | 2018             |
/// | eucm                | alpha beta           | (x, y) / (alpha e + (1 - alpha) z),          | Khomutenko et    |
/// |                     |                      | e^2 = beta (x^2 + y^2) + z^2                 | al. 2016         |
/// | mei                 | xi k1 k2 p1 p2       | B((x, y) / (z + xi d))                       | Mei & Rives 2007 |
// clang-format on
///
/// Each is valid in a cone about the optical axis: as far as it is one-to-one. Beyond that the formulas go on giving
/// pixels, wrong ones. The cone ends, for
/// - rectified, at 90 degrees;
/// - plumb_bob, rational_polynomial, mei, where the polynomial folds back or its denominator vanishes in any direction
///   off the axis, and for mei where the mirror's outline is: cosine of the angle -xi up to xi = 1, -1 / xi above;
/// - equidistant, where its polynomial stops growing, at most at 180 degrees;
/// - double_sphere, at cosine -w2 of Usenko's equations 43 to 45, or earlier where the denominator vanishes;
/// - eucm, at z = -w e, where w = alpha / (1 - alpha), or the inverse of that when alpha is above one half.
enum class CameraModel { rectified, plumb_bob, rational_polynomial, equidistant, double_sphere, eucm, mei };

/// How points in the camera's optical frame (x right, y down, z forward, metres) become pixels of an image.
/// Pixel (0, 0) is the centre of the top left pixel. Immutable: made by `make`, valid ever after.
class Camera {
 public:
  /// `intrinsics` is (fx, fy, cx, cy) in pixels; `distortion` as the table above has it. Fails with `bad_camera` when
  /// sizes, counts or ranges are off (1 < f < 1e5, finite numbers, at most 64 Mpx; double_sphere -1 < xi <= 1 and
  /// 0 <= alpha <= 1; eucm 0 <= alpha <= 1 and beta > 0; mei 0 <= xi <= 100).
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
  double fold_rad_ = 0;  // half the angle of the model's cone
  double min_cosine_ = 1;
  double max_angle_rad_ = 0;
};

[[nodiscard]] Result<CameraModel> parse_camera_model(std::string_view name);
[[nodiscard]] std::string_view to_string(CameraModel model);

}  // namespace calib
