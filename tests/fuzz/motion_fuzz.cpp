#include "dds/decode.hpp"
#include "fuzz/fuzz.hpp"
#include "support/ros_messages.hpp"

namespace calib::fuzz {

std::vector<Octets> seeds() {
  const test::ImuMessage good;
  Output out;
  out.put(good.sec).put(good.nanosec).put(good.angular_velocity).put(good.first_covariance);
  return {out.with({})};
}

void check(const Result<TurnRate>& rate) {
  if (!rate) return require(is_malformed(rate.error().code));
  require(rate->stamp.count() >= 0 && rate->rate_rad_s >= 0 && rate->rate_rad_s <= 100);
}

}  // namespace calib::fuzz

int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t size) {
  calib::fuzz::Input input(bytes, size);
  calib::test::ImuMessage imu;
  calib::test::OdometryMessage odometry;
  imu.sec = odometry.sec = input.take<std::int32_t>();
  imu.nanosec = odometry.nanosec = input.take<std::uint32_t>();
  imu.angular_velocity = odometry.angular_velocity = input.take<std::array<double, 3>>();
  imu.first_covariance = input.take<double>();
  calib::fuzz::check(calib::decode_imu(imu.raw()));
  calib::fuzz::check(calib::decode_odometry(odometry.raw()));
  return 0;
}
