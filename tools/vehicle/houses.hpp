#pragma once

#include "vehicle/mesh.hpp"

namespace calib::vehicle {

/// A house `width` metres wide along x of `pose`, its front on the x axis and looking towards -y.
void add_house(Mesh& mesh, const Eigen::Isometry3f& pose, float width, Random& random);

/// A lot with a low wall or a hedge in front and a small house or trees far behind it.
void add_garden(Mesh& mesh, const Eigen::Isometry3f& pose, float width, Random& random);

}  // namespace calib::vehicle
