#include "dds/names.hpp"

#include "support/catch.hpp"
#include "support/support.hpp"

using namespace calib;
using namespace calib::test;

TEST_CASE("a ROS topic has the DDS name that ROS 2 gives it") {
  CHECK(require_ok(dds_topic_name("/lidar/points")) == "rt/lidar/points");
  CHECK(require_ok(dds_topic_name("/a")) == "rt/a");
  CHECK(require_ok(dds_topic_name("/cam_0/image_raw")) == "rt/cam_0/image_raw");
  CHECK(require_ok(dds_topic_name("dds:Points1/a_b")) == "Points1/a_b");
}

TEST_CASE("a topic name that ROS 2 does not allow is refused") {
  for (const std::string bad : {"", "/", "lidar", "/a/", "//a", "/a//b", "/1a", "/a/2", "/a__b", "/a b", "/a-b",
                                "/\x1b", "dds:", "dds:a.b", "dds:a-b", "dds:1a", "dds:\x01"}) {
    INFO(bad);
    CHECK_FALSE(dds_topic_name(bad));
  }
  CHECK_FALSE(dds_topic_name("/" + std::string(300, 'a')));
  CHECK_FALSE(dds_topic_name("dds:" + std::string(256, 'a')));
}

TEST_CASE("a DDS topic is shown under its ROS name, or as a raw name") {
  CHECK(ros_topic_name("rt/lidar/points") == "/lidar/points");
  CHECK(ros_topic_name("rtlidar") == "dds:rtlidar");
  CHECK(ros_topic_name("rq/service") == "dds:rq/service");
  CHECK(ros_topic_name("") == "dds:");
}

TEST_CASE("the names of a topic are inverse to each other") {
  for (const std::string topic : {"/lidar/points", "/a", "dds:Points1/a_b", "dds:rt"}) {
    INFO(topic);
    CHECK(ros_topic_name(require_ok(dds_topic_name(topic))) == topic);
  }
}

TEST_CASE("a DDS type is shown under its ROS name, and one that is not ROS 2's as it is") {
  CHECK(ros_type_name("sensor_msgs::msg::dds_::Image_") == "sensor_msgs/msg/Image");
  for (const std::string other : {"Plain", "::dds_::X_", "a::dds_::X_", "a::msg::dds_::X", ""}) {
    INFO(other);
    CHECK(ros_type_name(other) == other);
  }
}

TEST_CASE("a topic of CompressedImage is known by the last part of its name") {
  CHECK(is_compressed_topic("/left/image/compressed"));
  CHECK_FALSE(is_compressed_topic("/compressed/image"));
  CHECK_FALSE(is_compressed_topic("/left/image_compressed"));
}

TEST_CASE("the name of a network interface cannot leave the XML that it is written into") {
  for (const char* name : {"auto", "lo", "eth0", "enp3s0.100", "wlan-a", "fe80::1", "br_0", "veth@if3"}) {
    INFO(name);
    CHECK(is_interface_name(name));
  }
  CHECK(is_interface_name(std::string(64, 'a')));
  CHECK_FALSE(is_interface_name(std::string(65, 'a')));
  for (const char* name : {"", "eth 0", "lo\"/>", "<lo>", "a&b", "\xc3\xa4", "a\n"}) {
    INFO(name);
    CHECK_FALSE(is_interface_name(name));
  }
}
