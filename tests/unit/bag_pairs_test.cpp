#include <chrono>

#include "dataset/bag/frame_pairs.hpp"
#include "dataset/bag/transform_tree.hpp"
#include "support/catch.hpp"
#include "support/support.hpp"

using namespace calib;
using namespace std::chrono_literals;

namespace {

StampedMessages every(std::chrono::milliseconds period, std::size_t count, std::chrono::milliseconds first = 0ms) {
  StampedMessages samples;
  for (std::size_t i = 0; i < count; ++i) samples.push_back({first + i * period, i});
  return samples;
}

/// A message of one transform, whose strings and sequence it keeps.
struct Transform {
  std::string parent, child;
  std::array<double, 3> t;
  std::array<double, 4> q{0, 0, 0, 1};
  geometry_msgs_msg_dds__TransformStamped_ sent{};
  tf2_msgs_msg_dds__TFMessage_ message{};

  const tf2_msgs_msg_dds__TFMessage_& raw() {
    sent.header.frame_id = parent.data();
    sent.child_frame_id = child.data();
    sent.transform = {{t[0], t[1], t[2]}, {q[0], q[1], q[2], q[3]}};
    message.transforms._buffer = &sent;
    message.transforms._length = 1;
    return message;
  }
};

void add(TransformTree& tree, const std::string& parent, const std::string& child, std::array<double, 3> t,
         TransformTree::Topic topic = TransformTree::Topic::tf_static, std::array<double, 4> q = {0, 0, 0, 1}) {
  Transform transform{parent, child, t, q};
  tree.add(transform.raw(), topic);
}

}  // namespace

TEST_CASE("each image has the nearest cloud, and none is used twice") {
  // 30 Hz and 10 Hz, a little apart.
  const auto result = pair_by_stamp(every(33ms, 30, 5ms), every(100ms, 10), nullptr, nullptr, 50ms);
  REQUIRE(result.pairs.size() == 10);
  CHECK(result.lacks.empty());
  for (const RecordedPair& pair : result.pairs) CHECK(std::chrono::abs(pair.image.stamp - pair.scan.stamp) <= 17ms);
  CHECK(result.pairs[3].scan.number == 3);
  // The other way about.
  const auto other = pair_by_stamp(every(100ms, 10), every(33ms, 30, 5ms), nullptr, nullptr, 50ms);
  CHECK(other.pairs.size() == 10);
}

TEST_CASE("what has no partner is told") {
  auto scans = every(100ms, 6);
  scans.erase(scans.begin() + 2);
  const auto result = pair_by_stamp(every(100ms, 5), scans, nullptr, nullptr, 50ms);
  CHECK(result.pairs.size() == 4);
  CHECK(result.lacks == std::vector<std::string>{"no cloud for 200000000"});
  CHECK(result.pairs[2].scan.number == 3);

  const auto none = pair_by_stamp(every(100ms, 5), every(100ms, 5, 10'000ms), nullptr, nullptr, 50ms);
  CHECK(none.pairs.empty());
  CHECK(none.why_none.find("images: 5 from 0 to 400000000 ns, clouds: 5 from 10000000000") != std::string::npos);
  CHECK(pair_by_stamp({}, every(100ms, 5), nullptr, nullptr, 50ms).pairs.empty());
  CHECK_FALSE(pair_by_stamp({}, {}, nullptr, nullptr, 50ms).why_none.empty());
}

TEST_CASE("a right image and depth are of the image's trigger") {
  const auto images = every(100ms, 4), scans = every(100ms, 4, 20ms), near = every(100ms, 4, 3ms),
             late = every(100ms, 4, 8ms);
  const auto both = pair_by_stamp(images, scans, &near, &near, 50ms);
  REQUIRE(both.pairs.size() == 4);
  CHECK(both.pairs[2].right_image->number == 2);
  CHECK(both.pairs[2].depth->stamp == 203ms);
  const auto without = pair_by_stamp(images, scans, &late, nullptr, 50ms);
  CHECK(without.pairs.empty());
  CHECK(without.lacks.front() == "no right image for 0");
  CHECK(pair_by_stamp(images, scans, nullptr, &late, 50ms).lacks.front() == "no depth for 0");
}

TEST_CASE("of two clouds that want one image, the nearer one has it") {
  const auto result = pair_by_stamp(every(1000ms, 1, 50ms), every(30ms, 1, 20ms), nullptr, nullptr, 50ms);
  CHECK(result.pairs.size() == 1);
  const StampedMessages images{{0ms, 0}, {40ms, 1}}, scans{{10ms, 0}};
  const auto shared = pair_by_stamp(images, scans, nullptr, nullptr, 50ms);
  REQUIRE(shared.pairs.size() == 1);
  CHECK(shared.pairs[0].image.number == 0);
}

TEST_CASE("a transform is found through frames above, below and on both sides") {
  TransformTree tree;
  add(tree, "base", "lidar", {1, 0, 2});
  add(tree, "/base", "mount", {0, 0, 1});
  add(tree, "mount", "camera", {0.5, 0, 0}, TransformTree::Topic::tf_static, {0.5, -0.5, 0.5, -0.5});
  const RigidTransform T_camera_lidar = test::require_ok(tree.find("camera", "lidar"));
  // The LiDAR's origin is 0.5 m ahead of the camera and 1 m above it.
  const Eigen::Vector3d p = T_camera_lidar * Eigen::Vector3d::Zero();
  CHECK((p - Eigen::Vector3d(0, -1, 0.5)).norm() < 1e-12);
  CHECK((T_camera_lidar * test::require_ok(tree.find("lidar", "camera"))).isApprox(RigidTransform::Identity(), 1e-12));
  CHECK((test::require_ok(tree.find("base", "lidar")).translation() == Eigen::Vector3d(1, 0, 2)));
  CHECK(test::require_ok(tree.find("lidar", "lidar")).isApprox(RigidTransform::Identity()));
}

TEST_CASE("a transform that is not there is told with the frames that there are") {
  TransformTree tree;
  CHECK(tree.find("camera", "lidar").error().context.find("no transform at all") != std::string::npos);
  add(tree, "base", "lidar", {1, 0, 2});
  add(tree, "map", "camera", {1, 0, 2});
  const auto missing = tree.find("camera", "lidar");
  CHECK(missing.error().code == ErrorCode::calibration_missing);
  CHECK(missing.error().context.find("base, camera, lidar, map") != std::string::npos);
  CHECK_FALSE(tree.connects("camera", "lidar"));
}

TEST_CASE("a transform of /tf is used where it never changes") {
  TransformTree tree;
  for (int i = 0; i < 3; ++i) add(tree, "base", "lidar", {1, 0, 2}, TransformTree::Topic::tf);
  add(tree, "base", "camera", {1, 0, 1});
  CHECK(test::require_ok(tree.find("camera", "lidar")).translation() == Eigen::Vector3d(0, 0, 1));
  add(tree, "base", "lidar", {1, 0.001, 2}, TransformTree::Topic::tf);
  CHECK(tree.find("camera", "lidar").error().context.find("from 'lidar' to 'base' changes") != std::string::npos);
  // What moves elsewhere does not matter, and /tf_static goes first.
  add(tree, "odom", "base", {0, 0, 0}, TransformTree::Topic::tf);
  add(tree, "odom", "base", {1, 0, 0}, TransformTree::Topic::tf);
  add(tree, "base", "lidar", {1, 0, 3});
  CHECK(test::require_ok(tree.find("camera", "lidar")).translation() == Eigen::Vector3d(0, 0, 2));
}

TEST_CASE("transforms that are none, loops and changes of /tf_static do no harm") {
  TransformTree tree;
  add(tree, "a", "b", {0, 0, std::numeric_limits<double>::quiet_NaN()});
  add(tree, "a", "b", {0, 0, 0}, TransformTree::Topic::tf_static, {0, 0, 0, 0});
  add(tree, "a", "a", {0, 0, 1});
  CHECK(tree.remarks().size() == 3);
  CHECK_FALSE(tree.connects("a", "b"));
  add(tree, "a", "b", {0, 0, 1});
  add(tree, "b", "a", {0, 0, 1});
  (void)tree.find("a", "b");
  CHECK_FALSE(tree.find("a", "c"));
  add(tree, "x", "y", {1, 0, 0});
  add(tree, "x", "y", {2, 0, 0});
  CHECK(test::require_ok(tree.find("x", "y")).translation().x() == 2);
  CHECK(tree.remarks().back() == "/tf_static has different transforms of y: the last one is used");
}
