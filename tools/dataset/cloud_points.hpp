#pragma once

#include <cmath>
#include <filesystem>

#include "calib/cloud_layout.hpp"
#include "calib/frame.hpp"
#include "calib/result.hpp"

namespace calib {

/// Collects the points of a file that a `LidarScan` may hold.
class CloudPoints {
 public:
  void add(double x, double y, double z, double reflectance) {
    measurable_.add(x, y, z);
    LidarPoint point{static_cast<float>(x), static_cast<float>(y), static_cast<float>(z),
                     static_cast<float>(reflectance)};
    const float range = std::hypot(point.x_m, point.y_m, point.z_m);
    if (!(range > 0 && range <= 500)) return;  // NaN fails both
    if (!std::isfinite(point.reflectance)) point.reflectance = 0;
    scan_.points.push_back(point);
  }
  LidarScan& scan() { return scan_; }
  /// Fails with `cloud_layout` when too many coordinates are none: the file was written otherwise than it says.
  [[nodiscard]] Result<LidarScan> take(const std::filesystem::path& path) {
    if (const auto objection = measurable_.objection())
      return fail(ErrorCode::cloud_layout, path.string() + ": " + *objection + "; was it written as it says?");
    return std::move(scan_);
  }

 private:
  LidarScan scan_;
  MeasurableCount measurable_;
};

}  // namespace calib
