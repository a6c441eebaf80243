#include "calib/depth.hpp"

#include <algorithm>

namespace calib {

double DepthMap::valid_share() const {
  if (inverse_depth.empty()) return 0;
  const auto valid = std::ranges::count_if(inverse_depth, [](float value) { return value > no_depth; });
  return static_cast<double>(valid) / static_cast<double>(inverse_depth.size());
}

}  // namespace calib
