#pragma once

#include <vector>

#include "calib/search.hpp"
#include "calib_eval/recording_frames.hpp"

namespace calib::eval {

/// The objective along one axis about the recording's extrinsic. Offsets in degrees or cm, as the axis is.
struct Curve {
  int axis = 0;  // of `axis_names`
  std::vector<double> offsets, scores;

  /// The offset that scores best.
  [[nodiscard]] double maximum_at() const;
};

/// The objective over two axes: `scores[i * offsets[1].size() + j]` at the i-th offset of the first and the j-th of the
/// second.
struct Surface {
  std::array<int, 2> axes{};
  std::array<std::vector<double>, 2> offsets;
  std::vector<double> scores;
};

/// How far to look to either side, and in how many points: an odd number, which has the extrinsic itself among them.
struct LookAround {
  double rotation_deg = 5;
  double translation_cm = 50;
  int points = 41;

  [[nodiscard]] double range(int axis) const { return axis < 3 ? rotation_deg : translation_cm; }
  /// Between two points.
  [[nodiscard]] double step(int axis) const { return 2 * range(axis) / (points - 1); }
  [[nodiscard]] SearchBounds bounds() const { return {rotation_deg * radians_per_degree, translation_cm / 100}; }
};

[[nodiscard]] constexpr bool is_rotation(int axis) { return axis < 3; }
[[nodiscard]] constexpr const char* unit_of(int axis) { return is_rotation(axis) ? "deg" : "cm"; }

[[nodiscard]] Curve curve(Frames frames, const RigidTransform& T_camera_lidar, const Objective& objective, int axis,
                          const LookAround& around, int threads);
[[nodiscard]] Surface surface(Frames frames, const RigidTransform& T_camera_lidar, const Objective& objective,
                              const std::array<int, 2>& axes, const LookAround& around, int threads);

/// "roll:pitch" as two different axes. Fails with `unknown_axis`.
[[nodiscard]] Result<std::array<int, 2>> parse_axis_pair(const std::string& text);

}  // namespace calib::eval
