#pragma once

#include <vector>

#include "calib/depth.hpp"
#include "calib/depth_model.hpp"

namespace calib {

/// The size of a network's input, and the rectangle of it in which the image lies; pixels.
struct Placement {
  int width, height;
  int x, y, image_width, image_height;
};

[[nodiscard]] Placement place(const NetworkInput& input, int image_width, int image_height);

/// The input tensor. Grey images are made coloured by repetition.
[[nodiscard]] std::vector<float> to_tensor(const NetworkInput& input, const Placement& placement, const Image& image);

/// A network's output: one value a pixel, row-major, of a size that need not be the input's.
struct NetworkMap {
  int width, height;
  std::vector<float> values;
};

/// Depth of an image of the size of `camera`, from an output for the input placed so. What is out of range, not finite
/// or not in front is no depth.
///
/// Inverse depth is interpolated linearly: that of a plane is affine in the pixel, so slopes such as the road stay
/// exact, where the nearest value would make stairs of them. At an edge that makes up values over one pixel of the
/// network's, which networks blur over more. Next to a pixel without depth the nearest one decides, so that neither
/// depth nor its absence grows.
[[nodiscard]] DepthMap to_depth(const NetworkOutput& output, const Placement& placement, const NetworkMap& map,
                                const Camera& camera);

}  // namespace calib
