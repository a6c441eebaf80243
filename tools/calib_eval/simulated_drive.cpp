#include "calib_eval/simulated_drive.hpp"

#include <cmath>

#include "calib_eval/parallel.hpp"
#include "vehicle/vehicle.hpp"

namespace calib::eval {
namespace {

/// What the camera cannot see, the LiDAR need not measure.
constexpr double lidar_view_deg = 130;

DepthMap true_depth(const vehicle::SeenFrame& seen) {
  DepthMap depth{seen.image.width, seen.image.height, {}};
  depth.inverse_depth.reserve(seen.depth_m.size());
  for (const float metres : seen.depth_m)
    depth.inverse_depth.push_back(std::isfinite(metres) ? 1 / metres : DepthMap::no_depth);
  return depth;
}

}  // namespace

Result<SimulatedDrive> SimulatedDrive::drive(const DriveOptions& options) {
  std::vector<vehicle::Vehicle> vehicles;
  for (int place = 0; place < options.places; ++place) {
    vehicle::Simulation simulation;
    simulation.seed = options.seed + place;
    simulation.lidar.field_of_view_deg = lidar_view_deg;
    auto made = vehicle::simulated_vehicle(simulation);
    if (!made) return propagate(made);
    vehicles.push_back(*std::move(made));
  }
  SimulatedDrive drive{vehicles[0].camera, vehicles[0].baseline_m, vehicles[0].T_camera_lidar, {}};
  drive.frames.resize(options.frames);
  // A street's frames follow each other, and belong to one thread.
  const auto first_of = [&](std::size_t place) { return place * drive.frames.size() / vehicles.size(); };
  std::vector<Result<void>> seen(vehicles.size());
  parallel_for(vehicles.size(), options.threads, [&](std::size_t place) {
    for (std::size_t i = first_of(place); i < first_of(place + 1) && seen[place]; ++i) {
      const std::size_t index = i - first_of(place);
      auto frame =
          vehicles[place].frame(index, options.period_s * static_cast<double>(index), RigidTransform::Identity());
      if (!frame)
        seen[place] = propagate(frame);
      else
        drive.frames[i] = {std::to_string(options.seed + place) + "/" + std::to_string(index), FramePair(*frame),
                           true_depth(*frame)};
    }
  });
  for (const auto& street : seen)
    if (!street) return propagate(street);
  return drive;
}

}  // namespace calib::eval
