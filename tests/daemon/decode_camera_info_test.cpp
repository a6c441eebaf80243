#include "dds/decode.hpp"
#include "support/catch.hpp"
#include "support/ros_messages.hpp"
#include "support/support.hpp"

using namespace calib;
using namespace calib::test;

namespace {

Result<CameraInfo> decode(CameraInfoMessage& message) { return decode_camera_info(message.raw()); }

}  // namespace

TEST_CASE("a CameraInfo is decoded unchanged") {
  CameraInfoMessage message;
  const CameraInfo info = require_ok(decode(message));
  CHECK(info.stamp == std::chrono::seconds(12) + std::chrono::nanoseconds(345));
  CHECK(info.width == 640);
  CHECK(info.height == 480);
  CHECK(info.model == CameraModel::plumb_bob);
  CHECK(info.D == message.d);
  CHECK(info.K == message.k);
  CHECK(info.P == message.p);
}

TEST_CASE("name and coefficients of a distortion model are converted for Camera") {
  struct Named {
    std::string name;
    std::size_t coefficients;
    CameraModel model;
    std::size_t taken;
  };
  for (const Named& named : std::vector<Named>{{"plumb_bob", 0, CameraModel::plumb_bob, 5},
                                               {"plumb_bob", 4, CameraModel::plumb_bob, 5},
                                               {"rational_polynomial", 8, CameraModel::rational_polynomial, 8},
                                               {"equidistant", 4, CameraModel::equidistant, 4},
                                               {"fisheye", 4, CameraModel::equidistant, 4},
                                               {"", 0, CameraModel::rectified, 0},
                                               {"none", 0, CameraModel::rectified, 0}}) {
    INFO(named.name << ", " << named.coefficients);
    CameraInfoMessage message;
    message.distortion_model = named.name;
    message.d.assign(named.coefficients, 0.01);
    const CameraInfo info = require_ok(decode(message));
    CHECK(info.model == named.model);
    CHECK(info.D.size() == named.taken);
    CHECK(Camera::make(info.model, info.width, info.height, {info.K[0], info.K[4], info.K[2], info.K[5]}, info.D));
  }
  CameraInfoMessage message;
  message.distortion_model = "rational_polynomial";  // as some drivers send it: 14 of which the last six say nothing
  message.d = {0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0, 0, 0, 0, 0, 0};
  CHECK(require_ok(decode(message)).D == std::vector{0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8});
  message.distortion_model = "\x1b[2Jthin_prism";
  const std::string refusal = decode(message).error().context;
  CHECK(refusal.find('\x1b') == std::string::npos);
  CHECK_THAT(refusal, Catch::Matchers::ContainsSubstring("thin_prism' is none of plumb_bob, "));
}

TEST_CASE("zeros behind the coefficients of a model say nothing, and other numbers are another model's") {
  CameraInfoMessage message;
  message.d = {0.1, 0.2, 0.3, 0.4, 0.5, 0, 0, 0};
  CHECK(require_ok(decode(message)).D == std::vector{0.1, 0.2, 0.3, 0.4, 0.5});
  message.d[6] = 0.01;
  CHECK_THAT(decode(message).error().context, Catch::Matchers::EndsWith(": this is rational_polynomial"));
  message.distortion_model = "equidistant";
  message.d = {0.1, 0.2, 0.3, 0.4, 0};
  CHECK(require_ok(decode(message)).D.size() == 4);
}

TEST_CASE("an uncalibrated camera is named; P alone will do") {
  CameraInfoMessage message;
  message.k = {};
  const CameraInfo info = require_ok(decode(message));
  CHECK(info.K == std::array<double, 9>{});
  CHECK(info.P[0] == 500);
  message.p = {};
  const auto none = decode(message);
  CHECK(word(none.error().code) == "malformed:uncalibrated");
  CHECK_THAT(none.error().context, Catch::Matchers::StartsWith("the driver says that this camera is not calibrated"));
  message.k = {500, 0, 320, 0, 510, 240, 0, 0, 1};
  message.binning_x = 2;
  const CameraInfo raw = require_ok(decode(message));
  CHECK(raw.P == std::array<double, 12>{});
  CHECK(raw.reduced_from == "640 x 480 with binning 2 x 1");
}

TEST_CASE("roi and binning of a CameraInfo give the intrinsics of the published image") {
  CameraInfoMessage message;
  message.p[3] = -500 * 0.5;  // a baseline of 0.5 m
  message.roi_x = 100, message.roi_y = 60, message.roi_width = 401, message.roi_height = 300;
  message.binning_x = 2, message.binning_y = 3;
  const CameraInfo info = require_ok(decode(message));
  CHECK(info.reduced_from == "640 x 480 with binning 2 x 3 and a roi of 401 x 300 at 100, 60");
  CHECK(info.width == 200);
  CHECK(info.height == 100);
  CHECK(info.K[0] == 250);
  CHECK(info.K[4] == 170);
  CHECK(info.P[3] == -250 * 0.5);
  // The block of full pixels 300 and 301 is pixel 100 of the image, so full pixel 300.5 is its centre.
  const auto pixel_of = [](double full, double offset, double binning) {
    return (full - offset - (binning - 1) / 2) / binning;
  };
  CHECK(pixel_of(300.5, 100, 2) == 100);
  CHECK(info.K[2] == Approx(pixel_of(320, 100, 2)));
  CHECK(info.K[5] == Approx(pixel_of(240, 60, 3)));
  CHECK(info.P[2] == Approx(info.K[2]));
  CHECK(info.P[6] == Approx(info.K[5]));

  CameraInfoMessage binned;  // a roi of zeros is the whole
  binned.binning_x = binned.binning_y = 2;
  const CameraInfo half = require_ok(decode(binned));
  CHECK((half.width == 320 && half.height == 240));
  CHECK(half.K[2] == 159.75);
}

TEST_CASE("binning and roi that a driver has applied already are ignored by the key, of all or of K and P alone") {
  CameraInfoMessage applied;  // all is of the image, and the binning is stated once more
  applied.binning_x = applied.binning_y = 2;
  applied.roi_x = 700, applied.roi_width = 9;  // outside, since the roi was of the full sensor
  CHECK(word(decode(applied).error().code) == "malformed:roi");
  const CameraInfo image = require_ok(decode_camera_info(applied.raw(), InfoReduction::ignored));
  CHECK((image.width == 640 && image.height == 480));
  CHECK(image.K == applied.k);
  CHECK(image.P == applied.p);
  CHECK(image.reduced_from.empty());

  CameraInfoMessage sensor;  // width and height are of the sensor, K and P of the image
  sensor.width = 2064, sensor.height = 1544;
  sensor.binning_x = sensor.binning_y = 4;
  CHECK(require_ok(decode(sensor)).K[0] == 125);
  const CameraInfo reduced = require_ok(decode_camera_info(sensor.raw(), InfoReduction::size_only));
  CHECK((reduced.width == 516 && reduced.height == 386));
  CHECK(reduced.K == sensor.k);
  CHECK(reduced.P == sensor.p);
  CHECK(reduced.reduced_from == "2064 x 1544 with binning 4 x 4");
}
