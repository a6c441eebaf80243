#pragma once

#include "vehicle/mesh.hpp"

namespace calib::vehicle {

/// A piece of road of any kind and what lies on, beside and above it, made anew for every key. x along the road, d to
/// the left of its middle; 40 m behind the origin to 320 m ahead.
class Roadside {
 public:
  explicit Roadside(std::uint64_t key);

  [[nodiscard]] const Mesh& mesh() const { return mesh_; }
  /// Half the width of what is driven on, metres.
  [[nodiscard]] float half_width() const { return half_width_; }
  /// A place `height` above the ground, turned to the left by `heading` from the road's direction.
  [[nodiscard]] Eigen::Isometry3f pose(float x, float d, float height, float heading) const;
  /// Leaves a free space about (0, d) for the vehicle that looks on, and fills the rest.
  void fill(float d);

 private:
  struct Side {
    float verge, slope, plateau, kerb;  // width of the strip by the road, rise of what follows, where it ends, its step
    Surface verge_surface, land;
    float green;  // share of what grows among all that stands there
  };

  [[nodiscard]] float ground(float x, float d) const;
  [[nodiscard]] bool in_crossing(float x) const { return x > crossing_ && x < crossing_ + crossing_width_; }
  [[nodiscard]] bool is_free(float x, float d, float reach) const;
  void add_ground();
  void add_markings();
  void add_side(const Side& side, float sign);
  void add_segment(const Side& side, float sign, float from, float to);
  void add_row(float sign, float d, float from, float to, float gap, float heading);
  void add_traffic();
  void add_loose_things();
  void add_patches();
  Surface any_surface();

  Random random_;
  Mesh mesh_;
  float half_width_, lane_, bend_, sway_, sway_phase_, hill_, hill_phase_;
  float crossing_ = 1e6f, crossing_width_ = 0, own_d_ = 0;
  Side left_, right_;
};

}  // namespace calib::vehicle
