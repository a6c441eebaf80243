#include "depth/stereo.hpp"

#include "config.hpp"
#include "config_values.hpp"

namespace calib {

constinit const DepthSourceKind StereoDepthConfig::kind{
    .name = "stereo",
    .is_metric = true,
    .is_monocular = false,
    .colour = Colour::none,
    .remedies = {.few_valid = "are both images sharp, rectified and of one moment?",
                 .inverted = "the topic carries inverse depth where depth is expected, or the other way about",
                 .wrong_scale = "correct the baseline or the focal length"},
    .preparation_failure = {}};

StereoDepthConfig StereoDepthConfig::read(const ConfigNode& node, const CameraConfig& left) {
  node.with_keys(
      {"source", "range_m", "timeout", "right_image", "baseline_m", "right_camera", "right_info", "matcher"});
  StereoDepthConfig stereo{.right_image = read_topic(node.at("right_image")), .right_camera = {}, .right_info = {}};
  if (stereo.right_image == left.image) node.at("right_image").refuse("is the same topic as camera.image");
  const auto baseline = node.find("baseline_m"), camera = node.find("right_camera"), info = node.find("right_info");
  if (baseline.has_value() + camera.has_value() + info.has_value() != 1)
    node.refuse("needs one of baseline_m (rectified images), right_camera and right_info");
  const bool rectified = left.camera.model() == CameraModel::rectified;
  if (baseline) {
    if (!rectified)
      baseline->refuse("is for rectified images, and camera.model is " + std::string(to_string(left.camera.model())) +
                       "; write right_camera or right_info instead");
    stereo.right_camera = rectified_right_camera(left.camera, baseline->number(0.01, 10));
  }
  if (camera) {
    camera->with_keys({"model", "size", "intrinsics", "distortion", "T_right_left"});
    stereo.right_camera = RightCamera{read_camera_model(*camera), read_transform(camera->at("T_right_left"))};
  }
  if (info) stereo.right_info = read_topic(*info);
  if (info && !rectified && !left.info)
    info->refuse("needs camera.info too: both cameras say how they are to be rectified");
  if (const auto matcher = node.find("matcher")) {
    const std::string name = matcher->text();
    if (name != "sgbm" && name != "bm") matcher->refuse("is none of: sgbm, bm");
    stereo.matcher = name == "bm" ? StereoMatcher::bm : StereoMatcher::sgbm;
  }
  return stereo;
}

void StereoDepthConfig::add_topics(const Camera& left, PairTopics& topics) const {
  topics.right_image = right_image;
  topics.right_camera_info = right_info;
  topics.right_bound = right_camera ? ImageBound::exactly(size_of(right_camera->camera),
                                                          "depth.right_camera.size (with baseline_m: camera.size)")
                                    : ImageBound::similar(size_of(left), "camera.size");
}

bool StereoDepthConfig::has_cameras(const Camera& left, const StereoCameraInfo& infos) const {
  return !right_info || (infos.right && (infos.left || left.model() == CameraModel::rectified));
}

Result<std::unique_ptr<DepthEstimator>> StereoDepthConfig::make_estimator(const Camera& left,
                                                                          const StereoCameraInfo& infos) const {
  const auto right = right_camera ? *right_camera : calib::right_camera(left, infos);
  if (!right) return propagate(right);
  return make_stereo_depth(left, *right, matcher);
}

}  // namespace calib
