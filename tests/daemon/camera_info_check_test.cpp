#include "camera_info_check.hpp"

#include "support/catch.hpp"
#include "support/ros_messages.hpp"
#include "support/support.hpp"

using namespace calib;
using namespace calib::test;

namespace {

const Camera& camera(CameraModel model) {
  static const Camera rectified = require_ok(Camera::make(CameraModel::rectified, 640, 480, {500, 510, 320, 240}));
  static const Camera raw = require_ok(
      Camera::make(CameraModel::plumb_bob, 640, 480, {500, 510, 320, 240}, {-0.3, 0.1, 0.001, -0.002, 0.01}));
  return model == CameraModel::rectified ? rectified : raw;
}

std::string said(CameraInfoMessage message, CameraModel model) {
  const auto found = contradiction(require_ok(decode_camera_info(message.raw())), camera(model));
  return found ? found->seen : "";
}

}  // namespace

TEST_CASE("a zero P, as drivers send it that rectify nothing, falls back to K") {
  CameraInfoMessage message;
  CHECK(said(message, CameraModel::rectified).empty());
  message.p = {};
  CHECK(said(message, CameraModel::rectified).empty());
  message.k[0] = 501;
  CHECK(said(message, CameraModel::rectified) ==
        "CameraInfo's K has [501.00, 510.00, 320.00, 240.00], camera.intrinsics are [500.00, 510.00, 320.00, 240.00]");
}

TEST_CASE("rectified images have P's intrinsics, and raw ones K's") {
  CameraInfoMessage message;
  message.p[0] = 450;
  CHECK(said(message, CameraModel::plumb_bob).empty());
  CHECK(said(message, CameraModel::rectified).starts_with("CameraInfo's P has [450.00, "));
  message.k = {};  // nothing to compare a raw camera with
  CHECK(said(message, CameraModel::plumb_bob).empty());
}

TEST_CASE("another size is told with the raw values, binning and roi") {
  CameraInfoMessage message;
  message.binning_x = message.binning_y = 2;
  CHECK(said(message, CameraModel::rectified) ==
        "CameraInfo is for 320 x 240 pixels (640 x 480 with binning 2 x 2), camera.size is 640 x 480");
  const Error error =
      error_of(*contradiction(require_ok(decode_camera_info(message.raw())), camera(CameraModel::rectified)));
  CHECK(error.code == ErrorCode::camera_info_mismatch);
  CHECK_THAT(error.context, Catch::Matchers::EndsWith("without camera.info this is not checked"));
}
