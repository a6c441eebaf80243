#include "calib_eval/landscape.hpp"

#include <algorithm>

#include "calib_eval/parallel.hpp"

namespace calib::eval {
namespace {

std::vector<double> offsets_along(int axis, const LookAround& around) {
  std::vector<double> offsets;
  for (int i = 0; i < around.points; ++i) offsets.push_back(around.range(axis) * (2.0 * i / (around.points - 1) - 1));
  return offsets;
}

/// An offset in the unit that people read, in radians or metres.
double in_si(int axis, double offset) { return is_rotation(axis) ? offset * radians_per_degree : offset / 100; }

}  // namespace

double Curve::maximum_at() const { return offsets[std::ranges::max_element(scores) - scores.begin()]; }

Curve curve(Frames frames, const RigidTransform& T_camera_lidar, const Objective& objective, int axis,
            const LookAround& around, int threads) {
  Curve curve{axis, offsets_along(axis, around), {}};
  curve.scores.resize(curve.offsets.size());
  parallel_for(curve.offsets.size(), threads, [&](std::size_t i) {
    Vector6 delta = Vector6::Zero();
    delta[axis] = in_si(axis, curve.offsets[i]);
    curve.scores[i] = mean_score(frames, T_camera_lidar * perturbation(delta), objective).value;
  });
  return curve;
}

Surface surface(Frames frames, const RigidTransform& T_camera_lidar, const Objective& objective,
                const std::array<int, 2>& axes, const LookAround& around, int threads) {
  Surface surface{axes, {offsets_along(axes[0], around), offsets_along(axes[1], around)}, {}};
  const std::size_t columns = surface.offsets[1].size();
  surface.scores.resize(surface.offsets[0].size() * columns);
  parallel_for(surface.scores.size(), threads, [&](std::size_t i) {
    Vector6 delta = Vector6::Zero();
    delta[axes[0]] = in_si(axes[0], surface.offsets[0][i / columns]);
    delta[axes[1]] = in_si(axes[1], surface.offsets[1][i % columns]);
    surface.scores[i] = mean_score(frames, T_camera_lidar * perturbation(delta), objective).value;
  });
  return surface;
}

Result<std::array<int, 2>> parse_axis_pair(const std::string& text) {
  const auto axis = [](std::string_view name) {
    return static_cast<int>(std::ranges::find(axis_names, name) - axis_names.begin());
  };
  const auto colon = std::min(text.find(':'), text.size());
  const std::array axes{axis(std::string_view(text).substr(0, colon)),
                        colon < text.size() ? axis(std::string_view(text).substr(colon + 1)) : 6};
  if (axes[0] < 6 && axes[1] < 6 && axes[0] != axes[1]) return axes;
  return fail(ErrorCode::unknown_axis,
              "'" + escape_control(text) + "' is not two of roll, pitch, yaw, x, y, z with a colon between them");
}

}  // namespace calib::eval
