#include "dds/decode.hpp"

namespace calib {
namespace {

constexpr double max_rate_rad_s = 100;

Result<TurnRate> turn_rate(const std_msgs_msg_dds__Header_& header, const geometry_msgs_msg_dds__Vector3_& velocity) {
  const auto stamp = decode_stamp(header);
  if (!stamp) return propagate(stamp);
  // Not std::hypot: that of GCC returns 0 for (0, 0, NaN).
  const double rate = Eigen::Vector3d(velocity.x, velocity.y, velocity.z).norm();
  if (!(rate <= max_rate_rad_s))
    return fail(ErrorCode::malformed_angular_velocity, "the angular velocity is not finite, or not below 100 rad/s");
  return TurnRate{*stamp, rate};
}

}  // namespace

Result<TurnRate> decode_imu(const sensor_msgs_msg_dds__Imu_& message) {
  if (message.angular_velocity_covariance[0] == -1)
    return fail(ErrorCode::malformed_angular_velocity, "the sensor does not measure angular velocity (covariance -1)");
  return turn_rate(message.header, message.angular_velocity);
}

Result<TurnRate> decode_odometry(const nav_msgs_msg_dds__Odometry_& message) {
  return turn_rate(message.header, message.twist.twist.angular);
}

}  // namespace calib
