#pragma once

#include "vehicle/mesh.hpp"

namespace calib::vehicle {

// Each adds one thing to `mesh`, standing at the origin of `pose` (z up), in a look that `random` picks.
// Where a thing has a front, x points along the street and -y towards it.

void add_tree(Mesh& mesh, const Eigen::Isometry3f& pose, Random& random);
void add_lamp_post(Mesh& mesh, const Eigen::Isometry3f& pose, Random& random);
void add_traffic_sign(Mesh& mesh, const Eigen::Isometry3f& pose, Random& random);
void add_shelter(Mesh& mesh, const Eigen::Isometry3f& pose, Random& random);
void add_bollards(Mesh& mesh, const Eigen::Isometry3f& pose, Random& random);
/// A bench, a bin, a letter box, a planter or a switch cabinet.
void add_box_furniture(Mesh& mesh, const Eigen::Isometry3f& pose, Random& random);
void add_person(Mesh& mesh, const Eigen::Isometry3f& pose, Random& random);
/// A car, a van or a lorry that looks along x.
void add_car(Mesh& mesh, const Eigen::Isometry3f& pose, Random& random);

}  // namespace calib::vehicle
