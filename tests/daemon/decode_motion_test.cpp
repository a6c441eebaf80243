#include <cmath>
#include <limits>

#include "dds/decode.hpp"
#include "support/catch.hpp"
#include "support/ros_messages.hpp"
#include "support/support.hpp"

using namespace calib;
using namespace calib::test;
using namespace std::chrono_literals;

TEST_CASE("IMU and odometry give the turn rate about any axis") {
  for (const TurnRate& rate :
       {require_ok(decode_imu(ImuMessage{}.raw())), require_ok(decode_odometry(OdometryMessage{}.raw()))}) {
    CHECK(rate.stamp == 12s + 345ns);
    CHECK(rate.rate_rad_s == Approx(0.7));
  }
  ImuMessage upside_down;
  upside_down.angular_velocity = {-0.6, 0.2, 0.3};
  CHECK(require_ok(decode_imu(upside_down.raw())).rate_rad_s == Approx(0.7));
  ImuMessage still;
  still.angular_velocity = {0, 0, 0};
  CHECK(require_ok(decode_imu(still.raw())).rate_rad_s == 0);
}

TEST_CASE("a message without a valid angular velocity is refused") {
  constexpr double nan = std::numeric_limits<double>::quiet_NaN(), inf = std::numeric_limits<double>::infinity();
  for (const double bad : {nan, inf, -inf, 1e200, 101.0, -101.0})
    for (const std::size_t axis : {0, 1, 2}) {
      INFO(bad << " about axis " << axis);
      ImuMessage imu;
      OdometryMessage odometry;
      imu.angular_velocity[axis] = odometry.angular_velocity[axis] = bad;
      CHECK(decode_imu(imu.raw()).error().code == "malformed:angular_velocity");
      CHECK(decode_odometry(odometry.raw()).error().code == "malformed:angular_velocity");
      imu.angular_velocity = {0, 0, 0};
      imu.angular_velocity[axis] = bad;
      CHECK(decode_imu(imu.raw()).error().code == "malformed:angular_velocity");
    }
  ImuMessage none;
  none.first_covariance = -1;
  CHECK_THAT(decode_imu(none.raw()).error().context,
             Catch::Matchers::ContainsSubstring("does not measure angular velocity"));
  ImuMessage late;
  late.nanosec = 1'000'000'000;
  CHECK(decode_imu(late.raw()).error().code == "malformed:stamp");
  OdometryMessage early;
  early.sec = -1;
  CHECK(decode_odometry(early.raw()).error().code == "malformed:stamp");
}
