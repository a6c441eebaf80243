#include <chrono>
#include <opencv2/imgcodecs.hpp>
#include <optional>
#include <thread>

#include "dds/bus.hpp"
#include "support/catch.hpp"
#include "support/dds_peer.hpp"
#include "support/dds_samples.hpp"
#include "support/ros_messages.hpp"
#include "support/support.hpp"

using namespace calib;
using namespace calib::test;
using namespace std::chrono_literals;

namespace {

/// For samples of at most 1 MiB.
Bus& bus() {
  static Bus the_bus = require_ok(Bus::open(static_cast<std::uint32_t>(dds_domain()), "lo", 1 << 20));
  return the_bus;
}

Peer& peer() {
  static Peer the_peer(dds_domain());
  return the_peer;
}

const PairTopics topics{"/left/image", {}, "/points", {}};

}  // namespace

TEST_CASE("an image of another size is reported with its stamp and size, and is not decoded") {
  bus();
  const auto left = require_ok(make_writer(peer().participant(), image_type, "/left/image", reliable));
  const auto right =
      require_ok(make_writer(peer().participant(), compressed_image_type, "/right/compressed", reliable));
  PairTopics bounded = topics;
  bounded.right_image = "/right/compressed";
  bounded.image_bound = ImageBound::exactly({7, 4}, "camera.size");
  bounded.right_bound = ImageBound::exactly({7, 5}, "depth.right_camera.size");
  auto window = require_ok(bus().open_window(bounded));
  REQUIRE(eventually([&] { return readers_of(left) == 1 && readers_of(right) == 1; }));
  const auto refused = received(window, 1, [&] { publish(left, ImageMessage{}); });
  REQUIRE(find<Malformed>(refused));
  CHECK(find<Malformed>(refused)->topic == "/left/image");
  CHECK(find<Malformed>(refused)->error.code == "image_size_mismatch");
  CHECK(find<Malformed>(refused)->error.context == "the image is 6 x 4, and camera.size is 7 x 4");
  REQUIRE(find<Malformed>(refused)->image);
  CHECK(find<Malformed>(refused)->image->size == ImageSize{6, 4});
  CHECK(find<Malformed>(refused)->image->stamp == 12s + 345ns);
  CompressedImageMessage compressed;
  REQUIRE(cv::imencode(".png", cv::Mat(4, 5, CV_8UC1, cv::Scalar(77)), compressed.data));
  const auto compressed_refused = received(window, 1, [&] { publish(right, compressed); });
  REQUIRE(find<Malformed>(compressed_refused));
  CHECK(find<Malformed>(compressed_refused)->image->size == ImageSize{5, 4});
}

TEST_CASE("a cloud with too many points is reported as such") {
  bus();
  const auto cloud = require_ok(make_writer(peer().participant(), cloud_type, "/points", reliable));
  PairTopics bounded = topics;
  bounded.max_points = 5;
  auto window = require_ok(bus().open_window(bounded));
  REQUIRE(eventually([&] { return readers_of(cloud) == 1; }));
  const auto refused = received(window, 1, [&] { publish(cloud, CloudMessage{}); });
  REQUIRE(find<Malformed>(refused));
  CHECK(find<Malformed>(refused)->error.code == "malformed:cloud_size");
}

TEST_CASE("a window may be opened, read and destroyed by three threads") {
  bus();
  const auto cloud = require_ok(make_writer(peer().participant(), cloud_type, "/points", reliable));
  std::optional<SamplingWindow> window;
  std::thread([&] { window.emplace(require_ok(bus().open_window(topics))); }).join();
  REQUIRE(eventually([&] { return readers_of(cloud) == 1; }));
  std::vector<Sample> samples;
  std::thread([&] { samples = received(*window, 1, [&] { publish(cloud, CloudMessage{}); }); }).join();
  CHECK(find<DecodedCloud>(samples));
  window.reset();
  CHECK(eventually([&] { return readers_of(cloud) == 0; }));
}

TEST_CASE("a sample larger than the bus was opened for never arrives") {
  bus();
  const auto left = require_ok(make_writer(peer().participant(), image_type, "/left/image", reliable));
  auto window = require_ok(bus().open_window(topics));
  REQUIRE(eventually([&] { return readers_of(left) == 1; }));
  const auto arrives = [&](std::uint32_t height) {
    ImageMessage message;
    message.width = message.step = 1000, message.height = height;
    message.data.assign(std::size_t{1000} * height, 0);
    return !received(window, 1, [&] { publish(left, message); }).empty();
  };
  CHECK(arrives(1000));
  CHECK_FALSE(arrives(1100));
  CHECK(arrives(1000));
}

TEST_CASE("binning and roi of both cameras' CameraInfo are read as the topic says") {
  bus();
  const auto left = require_ok(make_writer(peer().participant(), camera_info_type, "/left/info", reliable));
  const auto right = require_ok(make_writer(peer().participant(), camera_info_type, "/right/info", reliable));
  PairTopics told = topics;
  told.camera_info = CameraInfoTopic{"/left/info"};
  told.right_camera_info = "/right/info";
  CameraInfoMessage binned;
  binned.binning_x = binned.binning_y = 2;
  for (const InfoReduction reduction : {InfoReduction::as_specified, InfoReduction::ignored}) {
    told.camera_info->reduction = reduction;
    const int width = reduction == InfoReduction::ignored ? 640 : 320;
    auto window = require_ok(bus().open_window(told));
    REQUIRE(eventually([&] { return readers_of(left) == 1 && readers_of(right) == 1; }));
    const auto samples = received(window, 2, [&] {
      publish(left, binned);
      publish(right, binned);
    });
    REQUIRE(find<CameraInfo>(samples));
    CHECK(find<CameraInfo>(samples)->width == width);
    REQUIRE(find<RightCameraInfo>(samples));
    CHECK(find<RightCameraInfo>(samples)->info.width == width);
  }
}
