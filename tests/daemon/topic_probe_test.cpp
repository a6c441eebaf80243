#include "topic_probe.hpp"

#include <algorithm>

#include "depth/depth_config.hpp"
#include "support/catch.hpp"
#include "support/support.hpp"

using namespace calib;
using namespace calib::test;
using namespace std::chrono_literals;

namespace {

const PairTopics stereo{.image = "/left/image", .right_image = "/right/image", .cloud = "/points"};

/// A probe of a stereo pair whose topics all have a publisher.
struct Probed {
  PairObservation seen{.camera = require_ok(Camera::make(CameraModel::rectified, 16, 16, {10, 10, 8, 8})),
                       .depth_kind = StereoDepthConfig::kind};
  TopicProbe probe;

  Probed() : probe(seen, PairBuffer(50ms, {.right_image = true})) {
    seen.topics = topics_to_probe(stereo, false);
    for (const TopicObservation& topic : seen.topics)
      if (topic.configured) seen.writers.push_back({topic.topic, topic.type, true, ""});
  }

  const TopicObservation& topic(const std::string& check) {
    return *std::ranges::find(seen.topics, check, &TopicObservation::check);
  }
  void add_image(Timestamp stamp, WallTime arrival) { probe.add(LeftImage{{stamp, 16, 16, {}}}, arrival); }
  void add_right_image(Timestamp stamp) { probe.add(RightImage{{stamp, 16, 16, {}}}, stamp); }
  void add_cloud(Timestamp stamp) {
    DecodedCloud cloud;
    cloud.stamp = stamp;
    cloud.statistics.points = 7;
    probe.add(std::move(cloud), stamp);
  }
};

}  // namespace

TEST_CASE("the topics to probe are those of the configuration, with the types that calibd reads") {
  const auto probed = topics_to_probe(stereo, false);
  REQUIRE(probed.size() == 4);
  CHECK((probed[0].key == "camera.image" && probed[0].type == "sensor_msgs/msg/Image"));
  CHECK((probed[1].key == "depth.right_image" && probed[1].topic == "/right/image"));
  CHECK((probed[2].key == "lidar.cloud" && probed[2].type == "sensor_msgs/msg/PointCloud2"));
  CHECK((probed[3].topic == "/left/camera_info" && !probed[3].configured && probed[2].configured));

  PairTopics others{.image = "/a/image/compressed", .cloud = "/points", .camera_info = CameraInfoTopic{"/told"}};
  others.depth = DepthTopic{"/d", DepthMessage::disparity};
  others.motion = MotionTopic{"/odom", MotionMessage::odometry};
  const auto all = topics_to_probe(others, true);
  REQUIRE(all.size() == 5);
  CHECK(all[0].type == "sensor_msgs/msg/CompressedImage");
  CHECK((all[1].key == "depth.disparity" && all[1].type == "stereo_msgs/msg/DisparityImage"));
  CHECK((all[2].key == "motion.topic" && all[2].type == "nav_msgs/msg/Odometry"));
  CHECK((all[4].topic == "/told" && all[4].configured));
}

TEST_CASE("CameraInfo stands beside its image, compressed or not") {
  CHECK(conventional_camera_info("/front/image_raw") == "/front/camera_info");
  CHECK(conventional_camera_info("/front/image_raw/compressed") == "/front/camera_info");
  CHECK(conventional_camera_info("/image") == "/camera_info");
}

TEST_CASE("messages are counted, with the age nearest to zero and the stamps that repeat") {
  Probed probed;
  probed.add_image(10s, 13s);
  probed.add_image(20s, 19s);
  probed.add_image(20s, 24s);
  const TopicObservation& image = probed.topic("image");
  CHECK(image.messages == 3);
  CHECK(image.repeated_stamps == 1);
  CHECK(image.age == -1s);
  CHECK((probed.seen.image->width == 16 && probed.seen.image->height == 16));
  CHECK(probed.topic("cloud").messages == 0);
}

TEST_CASE("samples become the latest pair, or a reason why there is none") {
  Probed probed;
  for (const Timestamp stamp : {10s, 11s}) {
    probed.add_image(stamp, stamp);
    probed.add_right_image(stamp);
    probed.add_cloud(stamp + 20ms);
  }
  const auto pair = probed.probe.take_pair();
  REQUIRE(pair);
  CHECK(pair->image.stamp == 11s);
  CHECK(require_ok(probed.seen.time_difference) == 20ms);
  CHECK(probed.seen.cloud->points == 7);

  Probed apart;
  apart.add_image(10s, 10s);
  apart.add_right_image(10s);
  apart.add_cloud(10s + 80ms);
  CHECK_FALSE(apart.probe.take_pair());
  CHECK(apart.seen.time_difference.error().code == "time_difference");
}

TEST_CASE("listening ends when each published topic brought enough, later without a pair") {
  Probed probed;
  for (int i = 1; i <= 5; ++i) {
    CHECK_FALSE(probed.probe.has_enough(4s));
    probed.add_image(i * 1s, i * 1s);
    probed.add_right_image(i * 1s);
    probed.add_cloud(i * 1s + 80ms);
  }
  CHECK_FALSE(probed.probe.has_enough(TopicProbe::shortest_without_pair));
  CHECK(probed.probe.has_enough(TopicProbe::shortest_without_pair + 1ms));
  probed.add_cloud(5s + 10ms);
  CHECK(probed.probe.has_enough(TopicProbe::shortest + 1ms));
  CHECK_FALSE(probed.probe.has_enough(TopicProbe::shortest));
}

TEST_CASE("a topic that nobody publishes, or whose messages cannot be used, is not waited for") {
  Probed probed;
  probed.seen.writers.clear();
  CHECK(probed.probe.has_enough(2s));
  probed.seen.writers.push_back({"/points", "sensor_msgs/msg/PointCloud2", true, ""});
  CHECK_FALSE(probed.probe.has_enough(2s));
  probed.seen.writers.back().obstacle = "it publishes in another partition";
  CHECK(probed.probe.has_enough(2s));
  probed.seen.writers.back().obstacle.clear();
  probed.probe.add(Malformed{"/points", Error{ErrorCode::malformed_xyz, "there is no x"}}, 1s);
  CHECK(probed.probe.has_enough(2s));
  CHECK(probed.topic("cloud").malformed.at("malformed:xyz") == 1);
  CHECK(probed.topic("cloud").malformed_context == "there is no x");
  CHECK(probed.topic("cloud").messages == 0);
}

TEST_CASE("an image of another size counts as a message, and its size is noted") {
  Probed probed;
  const Error error{ErrorCode::image_size_mismatch, "the image is 6 x 4"};
  probed.probe.add(Malformed{"/left/image", error, UndecodedImage{1s, {6, 4}}}, 2s);
  CHECK(probed.topic("image").messages == 1);
  CHECK(probed.topic("image").age == 1s);
  CHECK(probed.topic("image").malformed.empty());
  CHECK((probed.seen.image->width == 6 && !probed.seen.companion_mismatch));
  probed.probe.add(Malformed{"/right/image", error, UndecodedImage{1s, {6, 4}}}, 2s);
  CHECK(probed.seen.companion_mismatch == "/right/image: the image is 6 x 4");
  CHECK(probed.seen.image->width == 6);
  probed.probe.add(Malformed{"/unknown", error}, 2s);
}

TEST_CASE("CameraInfo of both cameras is kept, the last of each") {
  Probed probed;
  CHECK_FALSE(probed.probe.right_camera_info());
  for (const int width : {640, 320}) {
    CameraInfo info{};
    info.stamp = 1s;
    info.width = width;
    probed.probe.add(info, 1s);
    info.width += 1;
    probed.probe.add(RightCameraInfo{info}, 1s);
  }
  CHECK(probed.seen.camera_info->width == 320);
  CHECK(probed.probe.right_camera_info()->width == 321);
  CHECK(probed.topic("camera_info").messages == 2);
}
