#include "vehicle/knock.hpp"

namespace calib::vehicle {

Vector6 Knock::at(double t_s) const {
  if (t_s < start_s) return Vector6::Zero();
  const double minutes = (t_s - start_s) / 60;
  Vector6 delta;
  for (int i = 0; i < 3; ++i) {
    delta[i] = (rotation_deg[i] + drift_deg_per_minute[i] * minutes) * radians_per_degree;
    delta[3 + i] = (translation_cm[i] + drift_cm_per_minute[i] * minutes) / 100;
  }
  return delta;
}

void move_lidar(LidarScan& scan, const RigidTransform& motion) {
  const RigidTransform inverse = motion.inverse();
  for (LidarPoint& point : scan.points) {
    const Eigen::Vector3d p = inverse * Eigen::Vector3d(point.x_m, point.y_m, point.z_m);
    point.x_m = static_cast<float>(p.x()), point.y_m = static_cast<float>(p.y()), point.z_m = static_cast<float>(p.z());
  }
}

}  // namespace calib::vehicle
