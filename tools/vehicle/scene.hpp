#pragma once

#include <map>
#include <memory>
#include <vector>

#include "calib/geometry.hpp"
#include "vehicle/light.hpp"
#include "vehicle/mesh.hpp"
#include "vehicle/street.hpp"
#include "vehicle/texture.hpp"

namespace calib::vehicle {

/// A mesh where it is now.
struct Instance {
  const Mesh* mesh;
  RigidTransform T_world_mesh;
};

/// The world of one seed: the street, the traffic on it, and the vehicle's own way through it. What is where
/// at a time depends on the seed and that time alone.
class Scene {
 public:
  explicit Scene(std::uint64_t seed);

  /// The vehicle's frame (on the ground under it, x forward, y left, z up), `t_s` after the start.
  [[nodiscard]] RigidTransform T_world_vehicle(double t_s) const;

  /// All that is within sight of the vehicle at `t_s`: 160 m ahead, 90 m behind. Valid until the next call.
  [[nodiscard]] std::vector<Instance> instances(double t_s);

  [[nodiscard]] const NoiseTexture& noise() const { return noise_; }
  [[nodiscard]] const Light& light() const { return light_; }

 private:
  [[nodiscard]] double station(double t_s) const;
  void add_traffic(double t_s, std::vector<Instance>& result);
  const Mesh& model(std::uint64_t key, void (*add)(Mesh&, const Eigen::Isometry3f&, Random&));

  std::uint64_t seed_;
  Street street_;
  NoiseTexture noise_;
  Light light_;
  std::map<int, Mesh> blocks_;
  std::map<std::uint64_t, Mesh> models_;
};

}  // namespace calib::vehicle
