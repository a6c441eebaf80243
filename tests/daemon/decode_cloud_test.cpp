#include <algorithm>
#include <limits>

#include "dds/decode.hpp"
#include "support/catch.hpp"
#include "support/ros_messages.hpp"
#include "support/support.hpp"

using namespace calib;
using namespace calib::test;

namespace {

Result<DecodedCloud> decode(CloudMessage& message) { return decode_cloud(message.raw()); }

}  // namespace

TEST_CASE("a cloud keeps its points and their reflectance") {
  CloudMessage message;
  const LidarScan scan = require_ok(decode(message));
  CHECK(scan.stamp == std::chrono::seconds(12) + std::chrono::nanoseconds(345));
  REQUIRE(scan.points.size() == 6);
  for (int i = 0; i < 6; ++i) {
    CHECK(scan.points[i].x_m == 1.0F + static_cast<float>(i));
    CHECK(scan.points[i].y_m == 2.0F);
    CHECK(scan.points[i].z_m == 3.0F);
    CHECK(scan.points[i].reflectance == static_cast<float>(i));
  }
}

TEST_CASE("a cloud without points is an empty scan, with any number of rows") {
  CloudMessage message;
  message.data.clear();
  message.width = 0;
  message.height = 0xFFFFFFFF;
  CHECK(require_ok(decode(message)).points.empty());
  std::swap(message.width, message.height);
  CHECK(require_ok(decode(message)).points.empty());
}

TEST_CASE("points that are not measurements are dropped") {
  CloudMessage message;
  const auto set = [&](std::size_t point, std::size_t axis, float value) {
    std::memcpy(message.data.data() + 16 * point + 4 * axis, &value, sizeof(value));
  };
  set(0, 0, std::numeric_limits<float>::quiet_NaN());
  set(1, 1, std::numeric_limits<float>::infinity());
  set(2, 0, 500.1F);
  for (const std::size_t axis : {0, 1, 2}) set(3, axis, 0);  // the origin: no return
  set(4, 3, std::numeric_limits<float>::quiet_NaN());        // only the reflectance is lost
  const DecodedCloud scan = require_ok(decode(message));
  CHECK(scan.statistics.points == 6);
  CHECK(scan.statistics.not_finite == 2);
  CHECK(scan.statistics.too_far == 1);
  CHECK(scan.statistics.at_origin == 1);
  REQUIRE(scan.points.size() == 2);
  CHECK(scan.points[0].x_m == 5);
  CHECK(scan.points[0].reflectance == 0);
  CHECK(scan.points[1].x_m == 6);
}

TEST_CASE("statistics include points that are dropped for their range") {
  CloudMessage message;
  for (std::size_t point = 0; point < 6; ++point) {
    const float x = 8000.0F + static_cast<float>(point);
    std::memcpy(message.data.data() + 16 * point, &x, sizeof(x));
  }
  const DecodedCloud scan = require_ok(decode(message));
  CHECK(scan.points.empty());
  CHECK(scan.statistics.too_far == 6);
  CHECK(scan.statistics.median_range_m == Approx(8003).epsilon(1e-3));
}

TEST_CASE("a fault of a field that is not needed costs that field, and is named with its value and its bound") {
  const auto remark = [](const CloudField& field) {
    CloudMessage message;
    message.fields[3] = field;
    const DecodedCloud cloud = require_ok(decode(message));
    CHECK(cloud.points.size() == 6);
    CHECK(cloud.points[2].reflectance == 0);
    CHECK_FALSE(cloud.has_reflectance);
    REQUIRE(cloud.notes.remarks.size() == 1);
    return word(cloud.notes.remarks[0].code) + ": " + cloud.notes.remarks[0].context;
  };
  CHECK(
      remark({"intensity", 16}) ==
      "malformed:field_bounds: field 'intensity' ends at byte 20 (offset 16, 1 of 4 bytes), after point_step, which is "
      "16; the field is left out");
  CHECK(remark({"intensity", 0xFFFFFFFF, 7}).starts_with("malformed:field_bounds"));
  CHECK(remark({"intensity", 0, 8, 0xFFFFFFFF}).starts_with("malformed:field_bounds"));
  CHECK(remark({"\x1b[2J", 12, 9}) ==
        "malformed:field_type: field '\\x1b[2J' has datatype 9, which is none of 1 .. 8; the field is left out");
  CloudMessage many;
  for (int i = 0; i < 60; ++i) many.fields.push_back({"t", 17});
  CHECK(require_ok(decode(many)).notes.remarks.size() == 8);
}

TEST_CASE("a count of 0, as PCL writes it, is 1") {
  CloudMessage message;
  for (CloudField& field : message.fields) field.count = 0;
  const DecodedCloud cloud = require_ok(decode(message));
  CHECK(cloud.points[2].reflectance == 2);
  CHECK(cloud.notes.remarks.empty());
}

TEST_CASE("row_step is ignored where the cloud has one row or its data is without padding") {
  CloudMessage message;
  for (const std::uint32_t step : {0U, 47U, 9000U, 0xFFFFFFFFU}) {
    message.row_step = step;
    message.width = 3, message.height = 2;
    const DecodedCloud rows = require_ok(decode(message));
    CHECK(rows.points[5].x_m == 6);
    REQUIRE(rows.notes.remarks.size() == 1);
    CHECK(rows.notes.remarks[0].context ==
          "row_step is " + std::to_string(step) +
              ", and width * point_step is 48; the data is read as rows without padding");
    message.width = 6, message.height = 1;
    const DecodedCloud row = require_ok(decode(message));
    CHECK(row.points[5].x_m == 6);
    CHECK(row.notes.remarks.empty());
  }
}

TEST_CASE("a cloud whose coordinates no LiDAR measures is refused: its bytes are not what it says") {
  CloudMessage message;
  message.is_bigendian = true;  // and they are not
  const auto swapped = decode(message);
  REQUIRE_FALSE(swapped);
  CHECK(word(swapped.error().code) == "malformed:cloud_layout");
  CHECK_THAT(swapped.error().context, Catch::Matchers::ContainsSubstring(
                                          "100 % of the points have a coordinate that no LiDAR measures, such as"));
  CHECK_THAT(swapped.error().context, Catch::Matchers::ContainsSubstring("is_bigendian is true"));
}

TEST_CASE("the median range is one of what was measured, whatever the number of rings") {
  CloudMessage message;
  message.width = 64, message.height = 2048;  // in firing order; the first ring measures nothing
  message.row_step = 64 * 16;
  message.data.assign(std::size_t{64} * 2048 * 16, 0);
  for (std::uint32_t i = 0; i < 64 * 2048; ++i) {
    const float x = i % 64 == 0 ? std::numeric_limits<float>::quiet_NaN() : 10.0F + static_cast<float>(i % 64) / 64;
    std::memcpy(message.data.data() + 16 * i, &x, sizeof(x));
  }
  const DecodedCloud cloud = require_ok(decode(message));
  CHECK(cloud.statistics.not_finite == 2048);
  CHECK(cloud.statistics.median_range_m == Approx(10.5).margin(0.1));
}

TEST_CASE("the frame of a message is kept, cut and escaped") {
  CloudMessage message;
  CHECK(require_ok(decode(message)).notes.frame_id == "lidar");
  auto raw = message.raw();
  std::string hostile = "\x1b" + std::string(1000, 'f');
  raw.header.frame_id = hostile.data();
  CHECK(require_ok(decode_cloud(raw)).notes.frame_id == "\\x1b" + std::string(127, 'f'));
  std::string of_ros_1 = "/velodyne";
  raw.header.frame_id = of_ros_1.data();
  CHECK(require_ok(decode_cloud(raw)).notes.frame_id == "velodyne");
  raw.header.frame_id = nullptr;
  CHECK(require_ok(decode_cloud(raw)).notes.frame_id.empty());
}

TEST_CASE("reflectance is the first of its names that there is, else zero") {
  CloudMessage message;
  message.fields[3].name = "reflectance";
  CHECK(require_ok(decode(message)).points[2].reflectance == 2);
  message.fields.push_back({"intensity", 0, 7});
  CHECK(require_ok(decode(message)).points[2].reflectance == 3);  // x of that point
  message.fields.resize(3);
  message.fields.push_back({"i", 12});
  CHECK(require_ok(decode(message)).points[2].reflectance == 2);
  message.fields.push_back({"reflectivity", 0});
  CHECK(require_ok(decode(message)).points[2].reflectance == 3);
  message.fields.resize(3);
  message.fields.push_back({"echowidth", 12});  // of SICK's LD-MRS
  CHECK(require_ok(decode(message)).points[2].reflectance == 2);
  message.fields.resize(3);
  CHECK(require_ok(decode(message)).points[2].reflectance == 0);
}

namespace {

/// The same six points with every field of type `datatype` where it may have one, starting `shift` bytes into
/// a point.
template <typename Coordinate, typename Intensity>
CloudMessage laid_out(std::uint8_t coordinate_type, std::uint8_t intensity_type, std::uint32_t shift, bool big_endian) {
  CloudMessage message;
  constexpr std::uint32_t c = sizeof(Coordinate), n = sizeof(Intensity);
  message.fields = {{"x", shift, coordinate_type},
                    {"intensity", shift + c, intensity_type},
                    {"y", shift + c + n, coordinate_type},
                    {"z", shift + 2 * c + n, coordinate_type}};
  message.point_step = shift + 3 * c + n;
  message.row_step = 3 * message.point_step + 5;
  message.is_bigendian = big_endian;
  message.data.assign(2 * message.row_step, 0xEE);
  const auto put = [&](std::size_t at, auto value) {
    Octets bytes(sizeof(value));
    std::memcpy(bytes.data(), &value, sizeof(value));
    if (big_endian) std::ranges::reverse(bytes);  // the tests run on little-endian machines
    std::ranges::copy(bytes, message.data.begin() + at);
  };
  for (std::uint32_t i = 0; i < 6; ++i) {
    const std::size_t at = i / 3 * message.row_step + i % 3 * message.point_step + shift;
    put(at, static_cast<Coordinate>(1 + i));
    put(at + c, static_cast<Intensity>(i));
    put(at + c + n, static_cast<Coordinate>(2));
    put(at + 2 * c + n, static_cast<Coordinate>(3));
  }
  return message;
}

void check_same_points(CloudMessage message) {
  CloudMessage plain;
  const LidarScan expected = require_ok(decode(plain)), scan = require_ok(decode(message));
  REQUIRE(scan.points.size() == expected.points.size());
  for (std::size_t i = 0; i < scan.points.size(); ++i) {
    CHECK(scan.points[i].x_m == expected.points[i].x_m);
    CHECK(scan.points[i].y_m == expected.points[i].y_m);
    CHECK(scan.points[i].z_m == expected.points[i].z_m);
    CHECK(scan.points[i].reflectance == expected.points[i].reflectance);
  }
}

}  // namespace

TEST_CASE("unaligned and big-endian clouds of every field type decode to the same points") {
  for (const bool big_endian : {false, true})
    for (const std::uint32_t shift : {0U, 1U, 3U}) {
      INFO("big endian " << big_endian << ", shift " << shift);
      check_same_points(laid_out<float, std::int8_t>(7, 1, shift, big_endian));
      check_same_points(laid_out<float, std::uint8_t>(7, 2, shift, big_endian));
      check_same_points(laid_out<float, std::int16_t>(7, 3, shift, big_endian));
      check_same_points(laid_out<double, std::uint16_t>(8, 4, shift, big_endian));
      check_same_points(laid_out<double, std::int32_t>(8, 5, shift, big_endian));
      check_same_points(laid_out<float, std::uint32_t>(7, 6, shift, big_endian));
      check_same_points(laid_out<double, float>(8, 7, shift, big_endian));
      check_same_points(laid_out<float, double>(7, 8, shift, big_endian));
    }
}
