#pragma once

#include "vehicle/mesh.hpp"

namespace calib::vehicle {

/// A tree with a ragged crown, `height` metres tall, on the ground at the origin of `pose`; `cards` loose clusters of
/// leaves make its outline.
void add_ragged_tree(Mesh& mesh, const Eigen::Isometry3f& pose, float height, int cards, Random& random);

/// A bush, or a mass of greenery: leaves within the ellipsoid `radii` around `centre` (mesh frame).
void add_bush(Mesh& mesh, const Eigen::Vector3f& centre, const Eigen::Vector3f& radii, int cards, Random& random);

/// Blades and stalks on the ground around `centre`, within `radius`.
void add_tall_grass(Mesh& mesh, const Eigen::Vector3f& centre, float radius, int blades, Random& random);

}  // namespace calib::vehicle
