#include "dds/bus.hpp"

#include <chrono>
#include <cstdlib>
#include <limits>
#include <map>
#include <opencv2/imgcodecs.hpp>
#include <thread>

#include "dds/names.hpp"
#include "support/catch.hpp"
#include "support/dds_peer.hpp"
#include "support/dds_samples.hpp"
#include "support/ros_messages.hpp"
#include "support/support.hpp"

using namespace calib;
using namespace calib::test;
using namespace std::chrono_literals;

namespace {

/// One program has one Bus. It must come up whatever the environment tells Cyclone.
Bus& bus() {
  static Bus the_bus = [] {
    setenv("CYCLONEDDS_URI", "<CycloneDDS><Domain><General><Interfaces><NetworkInterface name='none0'/>", 1);
    return require_ok(Bus::open(static_cast<std::uint32_t>(dds_domain()), "lo"));
  }();
  return the_bus;
}

Peer& peer() {
  static Peer the_peer(dds_domain());
  return the_peer;
}

const PairTopics topics{"/left/image", "/right/image", "/points", CameraInfoTopic{"/left/camera_info"}};

}  // namespace

TEST_CASE("a window receives every topic of its pair, from reliable and from best-effort writers") {
  bus();
  const auto left = require_ok(make_writer(peer().participant(), image_type, "/left/image", reliable));
  const auto right = require_ok(make_writer(peer().participant(), image_type, "/right/image", best_effort));
  const auto cloud = require_ok(make_writer(peer().participant(), cloud_type, "/points", best_effort));
  const auto info = require_ok(make_writer(peer().participant(), camera_info_type, "/left/camera_info", reliable));
  auto window = require_ok(bus().open_window(topics));
  REQUIRE(eventually([&] {
    return readers_of(left) == 1 && readers_of(right) == 1 && readers_of(cloud) == 1 && readers_of(info) == 1;
  }));

  ImageMessage dark;
  dark.data.assign(24, 3);
  const auto samples = received(window, 4, [&] {
    publish(left, ImageMessage{});
    publish(right, dark);
    publish(cloud, CloudMessage{});
    publish(info, CameraInfoMessage{});
  });
  REQUIRE(samples.size() == 4);
  REQUIRE(find<LeftImage>(samples));
  CHECK(find<LeftImage>(samples)->image.pixels == std::vector<std::uint8_t>(24, 7));
  REQUIRE(find<RightImage>(samples));
  CHECK(find<RightImage>(samples)->image.pixels == std::vector<std::uint8_t>(24, 3));
  REQUIRE(find<DecodedCloud>(samples));
  CHECK(find<DecodedCloud>(samples)->points.size() == 6);
  REQUIRE(find<CameraInfo>(samples));
  CHECK(find<CameraInfo>(samples)->D.size() == 5);
}

TEST_CASE("every sample of the vehicle's turn rate is kept, from an IMU and from odometry") {
  bus();
  const auto imu = require_ok(make_writer(peer().participant(), imu_type, "/imu", reliable));
  const auto odometry = require_ok(make_writer(peer().participant(), odometry_type, "/odom", best_effort));
  PairTopics by_imu = topics, by_odometry = topics;
  by_imu.motion = MotionTopic{"/imu", MotionMessage::imu};
  by_odometry.motion = MotionTopic{"/odom", MotionMessage::odometry};
  auto window = require_ok(bus().open_window(by_imu));
  auto other = require_ok(bus().open_window(by_odometry));
  REQUIRE(eventually([&] { return readers_of(imu) == 1 && readers_of(odometry) == 1; }));
  REQUIRE(received(window, 1, [&] { publish(imu, ImuMessage{}); }).size() == 1);
  for (std::int32_t i = 0; i < 300; ++i) {
    ImuMessage message;
    message.sec = i;
    if (i == 299) message.angular_velocity[1] = std::numeric_limits<double>::quiet_NaN();
    publish(imu, message);
  }
  std::this_thread::sleep_for(300ms);
  const auto samples = require_ok(window.wait(1s));
  REQUIRE(samples.size() == 256);
  for (std::size_t i = 0; i < 255; ++i) {
    REQUIRE(std::get<TurnRate>(samples[i]).stamp == std::chrono::seconds(44 + i) + 345ns);
    REQUIRE(std::get<TurnRate>(samples[i]).rate_rad_s == Approx(0.7));
  }
  CHECK(std::get<Malformed>(samples[255]).error.code == "malformed:angular_velocity");
  CHECK(std::get<Malformed>(samples[255]).topic == "/imu");
  const auto from_odometry = received(other, 1, [&] { publish(odometry, OdometryMessage{}); });
  REQUIRE(find<TurnRate>(from_odometry));
  CHECK(find<TurnRate>(from_odometry)->rate_rad_s == Approx(0.7));
}

TEST_CASE("sensors are read only while a window is open") {
  bus();
  const auto left = require_ok(make_writer(peer().participant(), image_type, "/left/image", reliable));
  {
    const auto window = require_ok(bus().open_window(topics));
    CHECK(eventually([&] { return readers_of(left) == 1; }));
  }
  CHECK(eventually([&] { return readers_of(left) == 0; }));
}

TEST_CASE("a topic that ends in /compressed is read as CompressedImage") {
  bus();
  const auto left = require_ok(make_writer(peer().participant(), compressed_image_type, "/left/compressed", reliable));
  auto window = require_ok(bus().open_window({"/left/compressed", {}, "/points", {}}));
  REQUIRE(eventually([&] { return readers_of(left) == 1; }));
  CompressedImageMessage message;
  REQUIRE(cv::imencode(".png", cv::Mat(4, 5, CV_8UC1, cv::Scalar(77)), message.data));
  const auto samples = received(window, 1, [&] { publish(left, message); });
  REQUIRE(find<LeftImage>(samples));
  CHECK(find<LeftImage>(samples)->image.pixels == std::vector<std::uint8_t>(20, 77));
}

TEST_CASE("a raw DDS topic is read under its own name") {
  bus();
  const auto cloud = require_ok(make_writer(peer().participant(), cloud_type, "dds:Plain_points", reliable));
  auto window = require_ok(bus().open_window({"/left/image", {}, "dds:Plain_points", {}}));
  REQUIRE(eventually([&] { return readers_of(cloud) == 1; }));
  CHECK(find<DecodedCloud>(received(window, 1, [&] { publish(cloud, CloudMessage{}); })));
}

TEST_CASE("a malformed sample is reported with its topic and reason, and the next one arrives") {
  bus();
  const auto cloud = require_ok(make_writer(peer().participant(), cloud_type, "/points", reliable));
  auto window = require_ok(bus().open_window(topics));
  REQUIRE(eventually([&] { return readers_of(cloud) == 1; }));
  CloudMessage bad;
  bad.point_step = 0;
  const auto refused = received(window, 1, [&] { publish(cloud, bad); });
  REQUIRE(find<Malformed>(refused));
  CHECK(find<Malformed>(refused)->topic == "/points");
  CHECK(find<Malformed>(refused)->error.code == "malformed:point_step");
  CHECK(find<DecodedCloud>(received(window, 1, [&] { publish(cloud, CloudMessage{}); })));
}

TEST_CASE("only the newest sample of a burst is kept") {
  bus();
  const auto left = require_ok(make_writer(peer().participant(), image_type, "/left/image", reliable));
  auto window = require_ok(bus().open_window(topics));
  REQUIRE(eventually([&] { return readers_of(left) == 1; }));
  REQUIRE(received(window, 1, [&] { publish(left, ImageMessage{}); }).size() == 1);
  for (std::int32_t i = 0; i < 20; ++i) {
    ImageMessage message;
    message.sec = i;
    publish(left, message);
  }
  std::this_thread::sleep_for(300ms);
  const auto samples = require_ok(window.wait(1s));
  REQUIRE(samples.size() == 1);
  CHECK(std::get<LeftImage>(samples[0]).image.stamp == 19s + 345ns);
  CHECK(require_ok(window.wait(0s)).empty());
}

TEST_CASE("a wait ends with its timeout when nothing arrives") {
  auto window = require_ok(bus().open_window(topics));
  const auto begin = std::chrono::steady_clock::now();
  CHECK(require_ok(window.wait(200ms)).empty());
  const auto took = std::chrono::steady_clock::now() - begin;
  CHECK(took >= 199ms);
  CHECK(took < 2s);
}

TEST_CASE("an interrupt ends the wait in progress, or else the next one, and no more") {
  auto window = require_ok(bus().open_window(topics));
  std::thread other([] {
    std::this_thread::sleep_for(100ms);
    bus().interrupt();
  });
  const auto begin = std::chrono::steady_clock::now();
  CHECK(require_ok(window.wait(20s)).empty());
  CHECK(std::chrono::steady_clock::now() - begin < 5s);
  other.join();

  bus().interrupt();
  const auto next = std::chrono::steady_clock::now();
  CHECK(require_ok(window.wait(20s)).empty());
  CHECK(std::chrono::steady_clock::now() - next < 5s);

  const auto last = std::chrono::steady_clock::now();
  CHECK(require_ok(window.wait(200ms)).empty());
  CHECK(std::chrono::steady_clock::now() - last >= 199ms);
}

TEST_CASE("endpoints use XCDR1 and announce the hash of their type, as ROS 2 requires") {
  bus();
  const auto cloud = require_ok(make_writer(peer().participant(), cloud_type, "/points", reliable));
  const auto window = require_ok(bus().open_window(topics));
  dds_builtintopic_endpoint_t* endpoint = nullptr;
  // The reader of a window before may be about to leave.
  REQUIRE(eventually([&] {
    dds_instance_handle_t reader = 0;
    if (dds_get_matched_subscriptions(cloud.endpoint.get(), &reader, 1) == 1)
      endpoint = dds_get_matched_subscription_data(cloud.endpoint.get(), reader);
    return endpoint != nullptr;
  }));
  CHECK(std::string(endpoint->topic_name) == "rt/points");
  CHECK(std::string(endpoint->type_name) == "sensor_msgs::msg::dds_::PointCloud2_");
  void* user_data = nullptr;
  std::size_t size = 0;
  REQUIRE(dds_qget_userdata(endpoint->qos, &user_data, &size));
  CHECK(std::string(static_cast<char*>(user_data), size) ==
        "typehash=RIHS01_9198cabf7da3796ae6fe19c4cb3bdd3525492988c70522628af5daa124bae2b5;");
  dds_free(user_data);
  std::uint32_t count = 0;
  dds_data_representation_id_t* representations = nullptr;
  REQUIRE(dds_qget_data_representation(endpoint->qos, &count, &representations));
  REQUIRE(count == 1);
  CHECK(representations[0] == DDS_DATA_REPRESENTATION_XCDR1);
  dds_free(representations);
  dds_reliability_kind_t reliability{};
  REQUIRE(dds_qget_reliability(endpoint->qos, &reliability, nullptr));
  CHECK(reliability == DDS_RELIABILITY_BEST_EFFORT);
  dds_builtintopic_free_endpoint(endpoint);
}

TEST_CASE("diagnostics show the verdict of each pair as a level of ROS, with values and units") {
  Status status;
  status.vehicle = "demo-car";
  const Verdict verdicts[] = {Verdict::calibrated, Verdict::suspect, Verdict::drifted, Verdict::not_evaluated};
  for (const Verdict verdict : verdicts) {
    PairStatus& pair = status.pairs.emplace_back();
    pair.name = "front";
    pair.verdict = verdict;
    pair.reason = "low\x1boverlap";
  }
  status.pairs[2].misalignment.emplace();
  status.pairs[2].misalignment->delta << 0, 0, radians_per_degree, 0, 0.25, 0;
  status.pairs[2].record = PairStatus::Record{.sequence = 4, .key_id = "AB", .verified = true, .created = {}};
  const auto reader = require_ok(make_reader(peer().participant(), diagnostics_type, "/diagnostics", reliable));
  bus();
  REQUIRE(eventually([&] { return writers_to(reader) == 1; }));
  // A reader may know the writer a moment before the writer knows it: VOLATILE, so the first message may be
  // missed.
  int received = 0;
  const std::function look = [&](const diagnostic_msgs_msg_dds__DiagnosticArray_& message) {
    ++received;
    CHECK(message.header.stamp.sec == 1'700'000'000);
    CHECK(message.header.stamp.nanosec == 5);
    REQUIRE(message.status._length == 4);
    for (std::uint8_t i = 0; i < 4; ++i) CHECK(message.status._buffer[i].level == i);
    const auto& drifted = message.status._buffer[2];
    CHECK(std::string(drifted.name) == "calibd: front");
    CHECK(std::string(drifted.hardware_id) == "demo-car");
    CHECK(std::string(drifted.message) == "drifted: low\\x1boverlap");
    std::map<std::string, std::string> values;
    for (std::uint32_t i = 0; i < drifted.values._length; ++i)
      values[drifted.values._buffer[i].key] = drifted.values._buffer[i].value;
    CHECK(values["verdict"] == "drifted");
    CHECK(values["misalignment yaw [deg]"] == "1.000");
    CHECK(values["misalignment y [cm]"] == "25.000");
    CHECK(values["record sequence"] == "4");
    CHECK(values["record verified"] == "true");
  };
  CHECK(eventually([&] {
    require_ok(bus().publish_diagnostics(status, 1'700'000'000s + 5ns));
    std::this_thread::sleep_for(20ms);
    take_all<diagnostic_msgs_msg_dds__DiagnosticArray_>(reader, look);
    return received > 0;
  }));
}

TEST_CASE("a late reader gets the current proposed extrinsics") {
  ProposedExtrinsic first{"camera_front", "lidar_top", RigidTransform::Identity()}, second = first;
  first.T_camera_lidar.translation() = Eigen::Vector3d(1, 2, 3);
  second.camera_frame = "camera_rear";
  require_ok(bus().publish_proposed(std::vector{first}, 1s));
  require_ok(bus().publish_proposed(std::vector{first, second}, 2s));
  constexpr QosProfile latched{.reliable = true, .durable = true, .depth = 50};
  const auto reader =
      require_ok(make_reader(peer().participant(), transforms_type, "/calibd/tf_static_proposed", latched));
  int received = 0;
  CHECK(eventually([&] {
    received += take_all<tf2_msgs_msg_dds__TFMessage_>(reader, [](const tf2_msgs_msg_dds__TFMessage_& message) {
      REQUIRE(message.transforms._length == 2);
      const auto& transform = message.transforms._buffer[0];
      CHECK(transform.header.stamp.sec == 2);
      CHECK(std::string(transform.header.frame_id) == "camera_front");
      CHECK(std::string(transform.child_frame_id) == "lidar_top");
      CHECK(transform.transform.translation.z == 3);
      CHECK(transform.transform.rotation.w == 1);
      CHECK(std::string(message.transforms._buffer[1].header.frame_id) == "camera_rear");
    });
    return received > 0;
  }));
  CHECK(received == 1);
}

TEST_CASE("a late reader gets the last 32 alerts in order") {
  DriftAlert alert{.stamp = 7s,
                   .vehicle = "demo-car",
                   .pair = "front",
                   .verdict = Verdict::drifted,
                   .previous_verdict = Verdict::suspect,
                   .reason = "yaw",
                   .misalignment = {},
                   .record_sequence = 9};
  alert.misalignment.delta << 1, 2, 3, 4, 5, 6;
  alert.misalignment.sigma << 7, 8, 9, 10, 11, 12;
  for (alert.alert_sequence = 1; alert.alert_sequence <= 40; ++alert.alert_sequence)
    require_ok(bus().publish_alert(alert));
  constexpr QosProfile latched{.reliable = true, .durable = true, .depth = 64};
  const auto reader = require_ok(make_reader(peer().participant(), drift_alert_type, "/calibd/drift_alert", latched));
  std::vector<std::uint64_t> sequences;
  CHECK(eventually([&] {
    take_all<calibd_msgs_msg_dds__DriftAlert_>(reader, [&](const calibd_msgs_msg_dds__DriftAlert_& message) {
      sequences.push_back(message.alert_sequence);
      CHECK(std::string(message.verdict) == "drifted");
      CHECK(std::string(message.previous_verdict) == "suspect");
      CHECK(message.rotation_rad[2] == 3);
      CHECK(message.translation_m[0] == 4);
      CHECK(message.sigma_rotation_rad[0] == 7);
      CHECK(message.sigma_translation_m[2] == 12);
      CHECK(message.record_sequence == 9);
    });
    return sequences.size() >= 32;
  }));
  REQUIRE(sequences.size() == 32);
  for (std::size_t i = 0; i < 32; ++i) CHECK(sequences[i] == 9 + i);
}

TEST_CASE("invalid interfaces and topics are refused") {
  CHECK(Bus::open(90, "lo\"/><Evil a=\"").error().code == "bad_interface");
  CHECK(Bus::open(90, "").error().code == "bad_interface");
  CHECK(Bus::open(90, "nosuch0").error().code == "dds_failed");
  CHECK(bus().open_window({"left/image", {}, "/points", {}}).error().code == "bad_topic");
}
