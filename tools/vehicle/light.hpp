#pragma once

#include <Eigen/Core>

namespace calib::vehicle {

/// What lights a scene, and what its air and sky look like. Brightness is relative to a white surface facing the sun.
struct Light {
  Eigen::Vector3d sun = Eigen::Vector3d::UnitZ();  // unit vector towards it, world frame
  float sunlight = 0.55f;                          // on a surface that faces it
  float skylight = 0.55f;                          // from everywhere
  bool cast_shadows = false;
  float haze_m = 400;  // distance at which 63 % of what is seen is haze
  float haze = 0.8f;   // its brightness
  float horizon = 0.95f, drop = 0.35f,
        clouds = 0.05f;  // of the sky: at the horizon, how much darker overhead, contrast
};

}  // namespace calib::vehicle
