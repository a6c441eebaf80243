#pragma once

#include <Eigen/Geometry>
#include <cstdint>

#include "vehicle/mesh.hpp"

namespace calib::vehicle {

/// An endless, gently winding and rolling street: two lanes, parking lanes, pavements, and houses, with a
/// cross street now and then. A place on it is (x, d): x metres along the world's x axis, d metres to the
/// left of the centre line.
class Street {
 public:
  static constexpr float lane_edge_m = 3.6f;  // of the outermost lane's edge
  static constexpr float kerb_m = 6.f;        // of the kerb
  static constexpr float kerb_height_m = 0.14f;
  static constexpr float house_line_m = 9.2f;  // where houses without front gardens begin
  static constexpr float lot_depth_m = 60.f;   // how far the ground is laid out on either side
  static constexpr double block_m = 40;        // the street is made in blocks of this length
  static constexpr float crossing_m = 13.f;    // width of a cross street, at the beginning of its block

  explicit Street(std::uint64_t seed);

  /// Frame of the place (x, d): its x axis along the street, z up, on the road's surface.
  [[nodiscard]] Eigen::Isometry3d pose_at(double x, double d) const;
  [[nodiscard]] bool begins_with_crossing(int block) const;

  /// Everything of block `index` that never moves, in the frame `pose_at(index * block_m, 0)`.
  [[nodiscard]] Mesh block(int index) const;

 private:
  [[nodiscard]] Eigen::Vector3d centre(double x) const;

  std::uint64_t seed_;
  double phases_[3];
};

}  // namespace calib::vehicle
