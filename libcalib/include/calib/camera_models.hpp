#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <optional>
#include <span>
#include <string_view>
#include <variant>

/// How a lens bends rays. A pixel is f m + c, where m, on the normalised plane, is for the point p = (x, y, z) with
/// norm d and for n = (x, y) / z:
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
/// Each model is valid in a cone about the optical axis: as far as it is one-to-one. Beyond that the formulas go on
/// giving pixels, wrong ones.
///
/// A new model is a struct with the members of `Rectified`, one line in CALIB_CAMERA_MODELS, and its parameters in the
/// tests' list of lenses.
namespace calib::camera_models {

/// One number of the distortion.
struct Parameter {
  std::string_view name;
  /// The values that the model takes, in words; empty where every finite number will do.
  std::string_view range = {};
  bool (*in_range)(double value) = [](double) { return true; };
  /// May be left out, and is zero then. Only the last parameters may be.
  bool optional = false;
};

/// How sensor_msgs/CameraInfo names the model and gives its coefficients. Those beyond the model's own must be zero.
struct RosDistortion {
  std::string_view name, other_name;  // of distortion_model; the same twice where there is one
  bool (*takes)(std::size_t coefficients);
  std::string_view needed;  // "4 or 5 are needed"
};

/// The unit bearing inside the cone that a point of the normalised plane shows; nothing when there is none.
using Bearing = std::optional<Eigen::Vector3d>;

/// The pinhole. Its cone ends at 90 degrees.
struct Rectified {
  static constexpr std::array<Parameter, 0> parameters{};
  static constexpr std::optional<RosDistortion> ros{
      {"none", "", [](std::size_t) { return true; }, "without a model none may be there"}};

  /// `d` holds one number for each of `parameters`, inside its range.
  explicit Rectified(std::span<const double> d);
  /// Half the angle of the cone inside which the model is one-to-one.
  [[nodiscard]] double cone_rad() const;
  /// `p`, inside the cone and of norm `range`, on the normalised plane.
  [[nodiscard]] Eigen::Vector2d to_plane(const Eigen::Vector3d& p, double range) const;
  /// `cone_rad` is this lens', which takes long to compute.
  [[nodiscard]] Bearing from_plane(const Eigen::Vector2d& m, double cone_rad) const;
};

/// Brown's distortion of the normalised plane, with OpenCV's rational radial factor.
struct Brown {
  double k1, k2, p1, p2, k3 = 0, k4 = 0, k5 = 0, k6 = 0;

  [[nodiscard]] Eigen::Vector2d distort(const Eigen::Vector2d& m) const;
  /// The point of the disc of radius `fold` that `distort` maps to `target`; nothing when there is none.
  [[nodiscard]] std::optional<Eigen::Vector2d> undistort(const Eigen::Vector2d& target, double fold) const;
  /// Radius of the disc on which the distortion is one-to-one; at most 1000, 89.94 degrees off axis for a pinhole.
  [[nodiscard]] double fold_radius() const;
};

/// The cone of the three models with Brown's distortion ends where the polynomial folds back or its denominator
/// vanishes in any direction off the axis.
struct PlumbBob {
  static constexpr std::array<Parameter, 5> parameters{
      {{"k1"}, {"k2"}, {"p1"}, {"p2"}, {.name = "k3", .optional = true}}};
  static constexpr std::optional<RosDistortion> ros{
      {"plumb_bob", "plumb_bob", [](std::size_t count) { return count == 0 || count == 4 || count == 5; },
       "4 or 5 are needed"}};

  explicit PlumbBob(std::span<const double> d);
  [[nodiscard]] double cone_rad() const;
  [[nodiscard]] Eigen::Vector2d to_plane(const Eigen::Vector3d& p, double range) const;
  [[nodiscard]] Bearing from_plane(const Eigen::Vector2d& m, double cone_rad) const;

  Brown brown;
};

struct RationalPolynomial {
  static constexpr std::array<Parameter, 8> parameters{
      {{"k1"}, {"k2"}, {"p1"}, {"p2"}, {"k3"}, {"k4"}, {"k5"}, {"k6"}}};
  static constexpr std::optional<RosDistortion> ros{
      {"rational_polynomial", "rational_polynomial",
       [](std::size_t count) { return count == 8 || count == 12 || count == 14; },
       "8 are needed, and thin prism and tilt must be zero"}};

  explicit RationalPolynomial(std::span<const double> d);
  [[nodiscard]] double cone_rad() const;
  [[nodiscard]] Eigen::Vector2d to_plane(const Eigen::Vector3d& p, double range) const;
  [[nodiscard]] Bearing from_plane(const Eigen::Vector2d& m, double cone_rad) const;

  Brown brown;
};

/// The cone also ends where the mirror's outline is: at cosine -xi up to xi = 1, -1 / xi above.
struct Mei {
  static constexpr std::array<Parameter, 5> parameters{
      {{"xi", "0 <= xi <= 100", [](double xi) { return xi >= 0 && xi <= 100; }}, {"k1"}, {"k2"}, {"p1"}, {"p2"}}};
  static constexpr std::optional<RosDistortion> ros{};

  explicit Mei(std::span<const double> d);
  [[nodiscard]] double cone_rad() const;
  [[nodiscard]] Eigen::Vector2d to_plane(const Eigen::Vector3d& p, double range) const;
  [[nodiscard]] Bearing from_plane(const Eigen::Vector2d& m, double cone_rad) const;

  double xi;
  Brown brown;
};

/// The cone ends where the polynomial stops growing, at most at 180 degrees.
struct Equidistant {
  static constexpr std::array<Parameter, 4> parameters{{{"k1"}, {"k2"}, {"k3"}, {"k4"}}};
  static constexpr std::optional<RosDistortion> ros{
      {"equidistant", "fisheye", [](std::size_t count) { return count == 4; }, "4 are needed"}};

  explicit Equidistant(std::span<const double> d);
  [[nodiscard]] double cone_rad() const;
  [[nodiscard]] Eigen::Vector2d to_plane(const Eigen::Vector3d& p, double range) const;
  [[nodiscard]] Bearing from_plane(const Eigen::Vector2d& m, double cone_rad) const;

  double k1, k2, k3, k4;
};

/// The cone ends at cosine -w2 of Usenko's equations 43 to 45, or earlier where the denominator vanishes.
struct DoubleSphere {
  static constexpr std::array<Parameter, 2> parameters{
      {{"xi", "-1 < xi <= 1", [](double xi) { return xi > -1 && xi <= 1; }},
       {"alpha", "0 <= alpha <= 1", [](double alpha) { return alpha >= 0 && alpha <= 1; }}}};
  static constexpr std::optional<RosDistortion> ros{};

  explicit DoubleSphere(std::span<const double> d);
  [[nodiscard]] double cone_rad() const;
  [[nodiscard]] Eigen::Vector2d to_plane(const Eigen::Vector3d& p, double range) const;
  [[nodiscard]] Bearing from_plane(const Eigen::Vector2d& m, double cone_rad) const;

  double xi, alpha;
};

/// The cone ends at z = -w e, where w = alpha / (1 - alpha), or the inverse of that when alpha is above one half.
struct Eucm {
  static constexpr std::array<Parameter, 2> parameters{
      {{"alpha", "0 <= alpha <= 1", [](double alpha) { return alpha >= 0 && alpha <= 1; }},
       {"beta", "beta > 0", [](double beta) { return beta > 0; }}}};
  static constexpr std::optional<RosDistortion> ros{};

  explicit Eucm(std::span<const double> d);
  [[nodiscard]] double cone_rad() const;
  [[nodiscard]] Eigen::Vector2d to_plane(const Eigen::Vector3d& p, double range) const;
  [[nodiscard]] Bearing from_plane(const Eigen::Vector2d& m, double cone_rad) const;

  double alpha, beta;
};

}  // namespace calib::camera_models

namespace calib {

// The one table of camera models: the name that configuration, ROS and records use, and the struct. The enumerators,
// the variant and the lookup by name come from it.
#define CALIB_CAMERA_MODELS(MODEL)               \
  MODEL(rectified, Rectified)                    \
  MODEL(plumb_bob, PlumbBob)                     \
  MODEL(rational_polynomial, RationalPolynomial) \
  MODEL(equidistant, Equidistant)                \
  MODEL(double_sphere, DoubleSphere)             \
  MODEL(eucm, Eucm)                              \
  MODEL(mei, Mei)

enum class CameraModel {
#define CALIB_MODEL(name, Struct) name,
  CALIB_CAMERA_MODELS(CALIB_MODEL)
#undef CALIB_MODEL
};

/// What is known of a model without a camera that has it.
struct CameraModelFacts {
  CameraModel model;
  std::string_view name;
  std::span<const camera_models::Parameter> parameters;
  const std::optional<camera_models::RosDistortion>& ros;
};

/// Every model, in the order of the enumerators.
inline constexpr std::array all_camera_models{
#define CALIB_MODEL(name, Struct) \
  CameraModelFacts{CameraModel::name, #name, camera_models::Struct::parameters, camera_models::Struct::ros},
    CALIB_CAMERA_MODELS(CALIB_MODEL)
#undef CALIB_MODEL
};

[[nodiscard]] inline const CameraModelFacts& facts(CameraModel model) {
  return all_camera_models[static_cast<std::size_t>(model)];
}

namespace camera_models {

template <typename Unused, typename... Models>
using VariantOf = std::variant<Models...>;

}  // namespace camera_models

/// A lens with its parameters, of any model.
using CameraLens = camera_models::VariantOf<void
#define CALIB_MODEL(name, Struct) , camera_models::Struct
                                                CALIB_CAMERA_MODELS(CALIB_MODEL)
#undef CALIB_MODEL
                                            >;

/// `distortion` holds one number for each of the model's parameters, inside its range.
[[nodiscard]] CameraLens make_lens(CameraModel model, std::span<const double> distortion);

}  // namespace calib
