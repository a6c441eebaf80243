#include <algorithm>
#include <cstring>
#include <limits>

#include "dds/decode.hpp"
#include "support/catch.hpp"
#include "support/ros_messages.hpp"
#include "support/support.hpp"

using namespace calib;
using namespace calib::test;

namespace {

template <typename Pixel>
ImageMessage picture(const std::string& encoding, const std::vector<Pixel>& pixels, bool big_endian = false,
                     std::uint32_t padding = 0) {
  ImageMessage message;
  message.height = 1;
  message.width = static_cast<std::uint32_t>(pixels.size());
  message.step = static_cast<std::uint32_t>(pixels.size() * sizeof(Pixel)) + padding;
  message.encoding = encoding;
  message.is_bigendian = big_endian ? 1 : 0;
  message.data.assign(message.step, 0xEE);
  for (std::size_t i = 0; i < pixels.size(); ++i) {
    auto* at = message.data.data() + i * sizeof(Pixel);
    std::memcpy(at, &pixels[i], sizeof(Pixel));
    if (big_endian) std::reverse(at, at + sizeof(Pixel));
  }
  return message;
}

std::vector<float> depths(ImageMessage message) { return require_ok(decode_depth(message.raw())).inverse_depth; }

std::string refusal(ImageMessage message) { return word(decode_depth(message.raw()).error().code); }

}  // namespace

TEST_CASE("depth is read in millimetres and metres, in either byte order, with padded rows") {
  for (const bool big : {false, true})
    for (const std::uint32_t padding : {0U, 3U}) {
      const auto mm = picture<std::uint16_t>("16UC1", {0, 1000, 2500, 65535}, big, padding);
      CHECK(depths(mm) == std::vector<float>{0, 1, 0.4F, 1000.0F / 65535});
      const auto m = picture<float>("32FC1", {0, 2, 0.5F, 0.25F}, big, padding);
      CHECK(depths(m) == std::vector<float>{0, 0.5F, 2, 4});
    }
  const DepthImage depth = require_ok(decode_depth(picture<std::uint16_t>("16UC1", {7, 8}).raw()));
  CHECK((depth.width == 2 && depth.height == 1));
  CHECK(depth.stamp == std::chrono::seconds(12) + std::chrono::nanoseconds(345));
}

TEST_CASE("mono16 on a topic of depth is depth in millimetres, with a remark") {
  const DepthImage depth = require_ok(decode_depth(picture<std::uint16_t>("mono16", {0, 1000, 2500}).raw()));
  CHECK(depth.inverse_depth == std::vector<float>{0, 1, 0.4F});
  REQUIRE(depth.notes.remarks.size() == 1);
  CHECK(depth.notes.remarks[0].code == ErrorCode::malformed_encoding);
}

TEST_CASE("pixels without depth have none, and depth is never infinite, negative or NaN") {
  const float inf = std::numeric_limits<float>::infinity(), nan = std::numeric_limits<float>::quiet_NaN();
  CHECK(depths(picture<float>("32FC1", {nan, inf, -inf, -1, 0, 1e-45F})) == std::vector<float>(6));
}

TEST_CASE("a depth image outside of a bound is refused with the name of the bound") {
  const auto good = picture<float>("32FC1", {1, 2, 3});
  const auto spoilt = [&](auto spoil) {
    ImageMessage message = good;
    spoil(message);
    return refusal(message);
  };
  CHECK(spoilt([](ImageMessage& m) { m.encoding = "mono8"; }) == "malformed:encoding");
  CHECK(spoilt([](ImageMessage& m) { m.encoding = "16UC1; compressedDepth"; }) == "malformed:encoding");
  CHECK(spoilt([](ImageMessage& m) { m.width = 0; }) == "malformed:image_size");
  CHECK(spoilt([](ImageMessage& m) { m.width = m.height = 0xFFFFFFFF; }) == "malformed:image_size");
  CHECK(spoilt([](ImageMessage& m) { m.step = 11, m.data.resize(44); }) == "malformed:step");
  CHECK(spoilt([](ImageMessage& m) { m.data.pop_back(); }) == "malformed:image_data");
  CHECK(spoilt([](ImageMessage& m) { m.nanosec = 2'000'000'000; }) == "malformed:stamp");
}

TEST_CASE("a disparity image gives depth by its f and t, with the stamp of the outer header") {
  DisparityMessage message;
  const DepthImage depth = require_ok(decode_disparity(message.raw()));
  CHECK((depth.width == 6 && depth.height == 4));
  CHECK(depth.stamp == std::chrono::seconds(13) + std::chrono::nanoseconds(345));
  for (std::size_t i = 0; i < 24; ++i) CHECK(depth.inverse_depth[i] == Approx((1.0 + double(i)) / 100));
}

TEST_CASE("disparities outside of the range or of the valid window are no depth") {
  DisparityMessage message;
  message.min_disparity = 2;
  message.max_disparity = 20;
  message.window_x = message.window_y = 1;
  message.window_width = 5;
  message.window_height = 3;
  const auto depth = require_ok(decode_disparity(message.raw())).inverse_depth;
  for (int i = 0; i < 24; ++i) CHECK((depth[i] > 0) == (i / 6 >= 1 && i % 6 >= 1 && i + 1 <= 20));
}

TEST_CASE("a disparity image outside of a bound is refused with the name of the bound") {
  const auto refused = [](auto spoil) {
    DisparityMessage message;
    spoil(message);
    return word(decode_disparity(message.raw()).error().code);
  };
  const float nan = std::numeric_limits<float>::quiet_NaN(), large = std::numeric_limits<float>::max();
  CHECK(refused([](DisparityMessage& m) { m.image.encoding = "16UC1"; }) == "malformed:encoding");
  CHECK(refused([](DisparityMessage& m) { m.f = 0; }) == "malformed:disparity_scale");
  CHECK(refused([](DisparityMessage& m) { m.t = -0.5F; }) == "malformed:disparity_scale");
  CHECK(refused([&](DisparityMessage& m) { m.f = nan; }) == "malformed:disparity_scale");
  CHECK(refused([&](DisparityMessage& m) { m.f = m.t = large; }) == "malformed:disparity_scale");
  CHECK(refused([](DisparityMessage& m) { m.image.data.pop_back(); }) == "malformed:image_data");
  CHECK(refused([](DisparityMessage& m) { m.image.step = 8, m.image.data.resize(95); }) == "malformed:step");
  CHECK(refused([](DisparityMessage& m) { m.sec = -1; }) == "malformed:stamp");
}

TEST_CASE("what a disparity image says of its range and window costs no depth when it makes no sense") {
  const DepthImage good = require_ok(decode_disparity(DisparityMessage().raw()));
  CHECK(good.notes.remarks.empty());
  CHECK(good.notes.frame_id == "camera");
  const float nan = std::numeric_limits<float>::quiet_NaN();
  const auto remark = [&](auto spoil) {
    DisparityMessage message;
    spoil(message);
    const DepthImage depth = require_ok(decode_disparity(message.raw()));
    CHECK(depth.inverse_depth == good.inverse_depth);
    REQUIRE(depth.notes.remarks.size() == 1);
    return word(depth.notes.remarks[0].code) + ": " + depth.notes.remarks[0].context;
  };
  CHECK(
      remark([](DisparityMessage& m) { m.min_disparity = 1; }) ==
      "malformed:disparity_range: min_disparity is 1 and max_disparity 0, where the first must not exceed the second, "
      "and both must be finite; they are ignored");
  CHECK(remark([&](DisparityMessage& m) { m.max_disparity = nan; }).starts_with("malformed:disparity_range: "));
  // As image_pipeline's DisparityNode computes it before its image has a size.
  CHECK(remark([](DisparityMessage& m) {
          m.window_x = 70, m.window_y = 7, m.window_width = 0U - 78, m.window_height = 0U - 15;
        }) ==
        "malformed:valid_window: valid_window begins at 70, 7 and ends at 4294967288, 4294967288, and the image at "
        "6, 4; it is ignored");
  CHECK(remark([](DisparityMessage& m) {
          m.window_width = 7, m.window_height = 4;
        }).starts_with("malformed:valid_window"));
  CHECK(remark([](DisparityMessage& m) {
          m.window_x = 0xFFFFFFFF, m.window_width = m.window_height = 1;
        }).starts_with("malformed:valid_window"));
  CHECK(
      remark([](DisparityMessage& m) { m.image.step = 8; }).starts_with("malformed:step: step is 8, and a row has 24"));
}

TEST_CASE("negative disparities are no depth, and remarked") {
  DisparityMessage message;
  for (std::uint32_t i = 0; i < 24; ++i) {
    const float disparity = -2.0F - static_cast<float>(i);
    std::memcpy(message.image.data.data() + 4 * i, &disparity, 4);
  }
  const DepthImage depth = require_ok(decode_disparity(message.raw()));
  CHECK(std::ranges::all_of(depth.inverse_depth, [](float inverse) { return inverse == 0; }));
  REQUIRE(depth.notes.remarks.size() == 1);
  CHECK(depth.notes.remarks[0].code == ErrorCode::malformed_disparity_sign);
  CHECK(depth.notes.remarks[0].context.starts_with("24 disparities are negative and 0 positive"));
  for (std::uint32_t i = 0; i < 24; ++i) {  // as OpenCV marks pixels without one
    const float none = -1;
    std::memcpy(message.image.data.data() + 4 * i, &none, 4);
  }
  CHECK(require_ok(decode_disparity(message.raw())).notes.remarks.empty());
}
