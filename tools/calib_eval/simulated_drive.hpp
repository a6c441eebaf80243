#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "calib/camera.hpp"
#include "calib/depth.hpp"
#include "calib/geometry.hpp"

namespace calib::eval {

struct DriveOptions {
  int places = 8;        // streets, each of a seed of its own, counted from `seed`
  int frames = 96;       // of all streets together
  double period_s = 10;  // of driving, between two frames
  std::uint64_t seed = 1;
  int threads = 1;
};

/// What the sensors of the simulated vehicle see in streets of many kinds, one street after the other, with a LiDAR
/// that stays where it is.
struct SimulatedDrive {
  struct Frame {
    std::string name;  // seed of the street, number of the frame in it
    FramePair pair;    // with a right image
    DepthMap depth;    // the truth
  };

  Camera camera;
  double baseline_m = 0;
  RigidTransform T_camera_lidar;
  std::vector<Frame> frames;

  /// The same at any number of threads. Fails as `simulated_vehicle` does.
  [[nodiscard]] static Result<SimulatedDrive> drive(const DriveOptions& options);
};

}  // namespace calib::eval
