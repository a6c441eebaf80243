#include "depth/topic.hpp"

#include "config_values.hpp"

namespace calib {

constinit const DepthSourceKind TopicDepthConfig::kind{
    .name = "topic",
    .is_metric = true,
    .is_monocular = false,
    .colour = Colour::none,
    .remedies = {.few_valid = "is it the right model, topic and range_m?",
                 .inverted = "the topic carries inverse depth where depth is expected, or the other way about",
                 .wrong_scale = "correct the unit of depth"},
    .preparation_failure = {}};

TopicDepthConfig TopicDepthConfig::read(const ConfigNode& node, const CameraConfig&) {
  node.with_keys({"source", "range_m", "timeout", "image", "disparity", "camera", "T_camera_depth"});
  const auto image = node.find("image"), disparity = node.find("disparity");
  if (image.has_value() == disparity.has_value())
    node.refuse("needs one of image (sensor_msgs/Image) and disparity (stereo_msgs/DisparityImage)");
  TopicDepthConfig depth;
  depth.topic = {read_topic(image ? *image : *disparity), image ? DepthMessage::image : DepthMessage::disparity};
  if (is_compressed_topic(depth.topic.name) || depth.topic.name.ends_with("/compressedDepth"))
    (image ? *image : *disparity).refuse("is a compressed topic; depth is read uncompressed");
  const auto camera = node.find("camera"), transform = node.find("T_camera_depth");
  if (camera.has_value() != transform.has_value())
    (camera ? *camera : *transform).refuse("camera and T_camera_depth belong together; write both, or none");
  if (camera) {
    camera->with_keys({"model", "size", "intrinsics", "distortion"});
    depth.camera = DepthCamera{read_camera_model(*camera), read_transform(*transform)};
  }
  return depth;
}

void TopicDepthConfig::add_topics(const Camera& image_camera, PairTopics& topics) const {
  topics.depth = topic;
  topics.depth_bound = camera ? ImageBound::exactly(size_of(camera->camera), "depth.camera.size")
                              : ImageBound::scaled(size_of(image_camera), "camera.size");
}

Result<std::unique_ptr<DepthEstimator>> TopicDepthConfig::make_estimator(const Camera& image_camera,
                                                                         const StereoCameraInfo&) const {
  return make_topic_depth(image_camera, camera);
}

}  // namespace calib
