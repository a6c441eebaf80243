#include "dds/image_bound.hpp"

#include "pair_topics.hpp"
#include "support/catch.hpp"
#include "support/support.hpp"

using namespace calib;
using namespace calib::test;

namespace {

std::string refusal(const ImageBound& bound, ImageSize seen) {
  const auto checked = bound.check(seen);
  if (checked) return "";
  CHECK(checked.error().code == "image_size_mismatch");
  return checked.error().context;
}

Camera camera(int width, int height) {
  return require_ok(Camera::make(CameraModel::rectified, width, height, {500, 500, 100, 100}));
}

PairConfig pair() {
  PairConfig pair{.name = "front",
                  .camera = {.image = "/left", .info = {}, .camera = camera(640, 480)},
                  .lidar = {.cloud = "/points"},
                  .depth = OnnxDepthConfig{},
                  .depth_range = {},
                  .drift = {},
                  .recalibration = {}};
  pair.lidar.max_points = 5000;
  return pair;
}

}  // namespace

TEST_CASE("an image of another size is refused with both sizes and the key") {
  const ImageBound bound = ImageBound::exactly({640, 480}, "camera.size");
  CHECK(refusal(bound, {640, 480}).empty());
  CHECK(refusal(bound, {480, 640}) == "the image is 480 x 640, and camera.size is 640 x 480");
  CHECK(bound.max_pixels() == 640 * 480);
}

TEST_CASE("registered depth may be scaled, to at most four times the pixels") {
  const ImageBound bound = ImageBound::scaled({640, 480}, "camera.size");
  CHECK(refusal(bound, {320, 240}).empty());
  CHECK(refusal(bound, {1280, 960}).empty());
  CHECK(refusal(bound, {322, 240}).empty());
  CHECK(refusal(bound, {324, 240}) ==
        "the image is 324 x 240, which does not have the aspect ratio of the camera's 640 x 480 "
        "(camera.size); give the depth camera's own intrinsics (depth.camera and "
        "T_camera_depth)");
  CHECK(refusal(bound, {1284, 963}) ==
        "the image is 1284 x 963, more than 4 times the pixels of 640 x 480 (camera.size)");
}

TEST_CASE("an image of unknown size has at most four times the pixels") {
  const ImageBound bound = ImageBound::similar({640, 480}, "camera.size");
  CHECK(refusal(bound, {100, 100}).empty());
  CHECK(refusal(bound, {1280, 960}).empty());
  CHECK_FALSE(refusal(bound, {1281, 960}).empty());
}

TEST_CASE("no image is larger than 64 Mpx") {
  CHECK(refusal({}, {8000, 8000}).empty());
  CHECK(ImageBound::similar({8000, 8000}, "camera.size").max_pixels() == max_image_pixels);
}

TEST_CASE("the topics of a pair have the image sizes of its configuration") {
  PairConfig config = pair();
  PairTopics topics = topics_of(config);
  CHECK_FALSE(refusal(topics.image_bound, {640, 481}).empty());
  CHECK(topics.max_points == 5000);
  CHECK(topics.colour == Colour::rgb);

  config.depth = StereoDepthConfig{.right_image = "/right", .right_camera = {}, .right_info = "/right/info"};
  topics = topics_of(config);
  CHECK(refusal(topics.right_bound, {1280, 960}).empty());
  CHECK_FALSE(refusal(topics.right_bound, {1280, 961}).empty());
  std::get<StereoDepthConfig>(config.depth).right_camera = RightCamera{camera(600, 400), RigidTransform::Identity()};
  topics = topics_of(config);
  CHECK(refusal(topics.right_bound, {600, 400}).empty());
  CHECK(refusal(topics.right_bound, {640, 480}).find("depth.right_camera.size") != std::string::npos);

  config.depth = TopicDepthConfig{.topic = {"/depth", DepthMessage::image}, .camera = {}};
  CHECK(refusal(topics_of(config).depth_bound, {320, 240}).empty());
  config.depth = TopicDepthConfig{.topic = {"/depth", DepthMessage::image},
                                  .camera = DepthCamera{camera(200, 100), RigidTransform::Identity()}};
  CHECK(refusal(topics_of(config).depth_bound, {200, 100}).empty());
  CHECK(refusal(topics_of(config).depth_bound, {320, 240}).find("depth.camera.size") != std::string::npos);
}

TEST_CASE("the largest message follows from the configuration") {
  constexpr std::uint32_t MiB = 1 << 20;
  Config config;
  config.pairs.push_back(pair());
  CHECK(max_sample_bytes(config) == 16 * MiB);
  config.pairs.push_back(pair());
  config.pairs.back().lidar.max_points = 1'000'000;
  CHECK(max_sample_bytes(config) == 64'000'000 + 4 * MiB);
  config.pairs.back().camera.camera = camera(8000, 8000);
  CHECK(max_sample_bytes(config) == 384'000'000 + 4 * MiB);
}
