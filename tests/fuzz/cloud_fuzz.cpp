#include <cmath>

#include "dds/decode.hpp"
#include "fuzz/fuzz.hpp"
#include "support/ros_messages.hpp"

namespace calib::fuzz {

std::vector<Octets> seeds() {
  const test::CloudMessage good;
  Output out;
  out.put(good.nanosec).put(good.width).put(good.height).put(good.point_step).put(good.row_step);
  out.put(good.is_bigendian).put(static_cast<std::uint8_t>(good.fields.size()));
  for (const auto& field : good.fields) out.put_text(field.name).put(field.offset).put(field.datatype).put(field.count);
  return {out.with(good.data)};
}

}  // namespace calib::fuzz

int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t size) {
  calib::fuzz::Input input(bytes, size);
  calib::test::CloudMessage message;
  message.nanosec = input.take<std::uint32_t>();
  message.width = input.take<std::uint32_t>();
  message.height = input.take<std::uint32_t>();
  message.point_step = input.take<std::uint32_t>();
  message.row_step = input.take<std::uint32_t>();
  message.is_bigendian = input.take<std::uint8_t>() & 1;
  message.fields.resize(input.take<std::uint8_t>());
  for (auto& field : message.fields) {
    field.name = input.take_text();
    field.offset = input.take<std::uint32_t>();
    field.datatype = input.take<std::uint8_t>();
    field.count = input.take<std::uint32_t>();
  }
  message.data = input.rest();
  const auto scan = calib::decode_cloud(message.raw());
  if (!scan) {
    calib::fuzz::require(is_malformed(scan.error().code));
    return 0;
  }
  for (const calib::LidarPoint& point : scan->points)
    calib::fuzz::require(std::hypot(point.x_m, point.y_m, point.z_m) < 500.001F && std::isfinite(point.reflectance));
  return 0;
}
