#include <stdexcept>

#include "dds/decode.hpp"
#include "dds/no_throw.hpp"
#include "support/catch.hpp"
#include "support/ros_messages.hpp"
#include "support/support.hpp"

using namespace calib;
using namespace calib::test;

TEST_CASE("the error for a cloud with too many points has their number, the bound and the key") {
  CloudMessage cloud;  // of 6 points
  CHECK(require_ok(decode_cloud(cloud.raw(), 6)).points.size() == 6);
  const auto refused = decode_cloud(cloud.raw(), 5);
  CHECK(refused.error().code == "malformed:cloud_size");
  CHECK(refused.error().context == "6 points where 5 are allowed (lidar.max_points)");
}

TEST_CASE("the row_step of a cloud with one row may be any") {
  CloudMessage cloud;
  cloud.width = 6, cloud.height = 1;
  cloud.row_step = 1'000'000;
  CHECK(require_ok(decode_cloud(cloud.raw())).points.size() == 6);
}

TEST_CASE("the size of an image is checked after its header and before its pixels") {
  const ImageBound bound = ImageBound::exactly({7, 4}, "camera.size");
  ImageMessage image;
  CHECK(decode_image(image.raw(), Colour::rgb, bound).error().code == "image_size_mismatch");
  CHECK(decode_image(image.raw(), Colour::none, ImageBound::exactly({6, 4}, "camera.size")));
  image.data.pop_back();
  CHECK(decode_image(image.raw(), Colour::rgb, bound).error().code == "malformed:image_data");
  ImageMessage depth;
  depth.encoding = "16UC1", depth.step = 12;
  depth.data.resize(48);
  CHECK(decode_depth(depth.raw(), bound).error().code == "image_size_mismatch");
  CHECK(decode_depth(depth.raw(), ImageBound::scaled({12, 8}, "camera.size")));
  DisparityMessage disparity;
  CHECK(decode_disparity(disparity.raw(), bound).error().code == "image_size_mismatch");
  CHECK(decode_disparity(disparity.raw(), ImageBound::exactly({6, 4}, "camera.size")));
}

TEST_CASE("an exception from a decoder becomes an error") {
  CHECK(require_ok(no_throw([]() -> Result<int> { return 7; })) == 7);
  CHECK(no_throw([]() -> Result<int> { throw std::bad_alloc(); }).error().code == "out_of_memory");
  const auto thrown = no_throw([]() -> Result<int> { throw std::runtime_error("no such thing"); });
  CHECK(thrown.error().code == "malformed:refused");
  CHECK(thrown.error().context == "it cannot be decoded: no such thing");
}
