#pragma once

#include <algorithm>
#include <string>
#include <vector>

#include "depth/depth_config.hpp"
#include "findings.hpp"
#include "support/catch.hpp"
#include "support/support.hpp"

namespace calib::test {

using namespace std::chrono_literals;

inline const std::string image_type_name = "sensor_msgs/msg/Image", cloud_type_name = "sensor_msgs/msg/PointCloud2";

inline TopicObservation topic(const std::string& check, const std::string& key, const std::string& name,
                              const std::string& type) {
  TopicObservation seen{.check = check, .key = key, .topic = name, .type = type};
  seen.messages = 20;
  seen.age = 30ms;
  return seen;
}

/// A stereo pair with which all is well.
inline PairObservation healthy() {
  PairObservation seen{.camera = require_ok(Camera::make(CameraModel::rectified, 640, 192, {370, 370, 320, 90})),
                       .depth_kind = StereoDepthConfig::kind};
  seen.pair = "front";
  seen.interface = "lo";
  seen.listened = 2s;
  seen.topics = {topic("image", "camera.image", "/left/image", image_type_name),
                 topic("right_image", "depth.right_image", "/right/image", image_type_name),
                 topic("cloud", "lidar.cloud", "/points", cloud_type_name),
                 topic("camera_info", "camera.info", "/left/camera_info", "sensor_msgs/msg/CameraInfo")};
  seen.topics[0].frame_id = "camera_optical", seen.topics[2].frame_id = "lidar";
  for (const TopicObservation& each : seen.topics) {
    seen.topics_in_use.insert(each.topic);
    seen.writers.push_back({each.topic, each.type, true, ""});
  }
  seen.image = ImageSize{640, 192};
  seen.camera_info = CameraInfo{.stamp = {},
                                .width = 640,
                                .height = 192,
                                .model = CameraModel::plumb_bob,
                                .K = {370, 0, 320, 0, 370, 90, 0, 0, 1},
                                .D = {0, 0, 0, 0, 0},
                                .P = {370, 0, 320, 0, 0, 370, 90, 0, 0, 0, 1, 0}};
  seen.cloud = CloudStatistics{60000, 100, 0, 0, 11.5};
  seen.time_difference = std::chrono::nanoseconds(2ms);
  seen.depth = DepthTrial{0.6, {}};
  seen.min_valid_depth = 0.15;
  seen.extrinsic = ExtrinsicOpinion{.points_in_view = 20000,
                                    .sees_nothing = false,
                                    .upright = true,
                                    .agreement = DepthAgreement{0.9, 1.02, 15000},
                                    .likely = {},
                                    .likely_agreement = {}};
  return seen;
}

inline TopicObservation& find(PairObservation& seen, const std::string& check) {
  return *std::ranges::find(seen.topics, check, &TopicObservation::check);
}

inline void silence(PairObservation& seen, const std::string& check) {
  TopicObservation& silent = find(seen, check);
  std::erase_if(seen.writers, [&](const RemoteWriter& writer) { return writer.topic == silent.topic; });
  silent.messages = 0;
  silent.frame_id.clear();
  silent.age = {};
  seen.time_difference = fail(ErrorCode::sensor_silent, "nothing came");
}

/// "check/code" of every problem.
inline std::vector<std::string> problems(const PairObservation& seen) {
  std::vector<std::string> found;
  for (const Finding& finding : diagnose(seen)) {
    if (finding.result != FindingResult::problem) continue;
    found.push_back(finding.check + "/" + finding.code);
    CHECK_FALSE(finding.cause.empty());
    CHECK_FALSE(finding.remedy.empty());
  }
  return found;
}

inline Finding finding(const PairObservation& seen, const std::string& check) {
  const auto findings = diagnose(seen);
  return *std::ranges::find(findings, check, &Finding::check);
}

inline bool holds(const std::string& text, const std::string& part) { return text.find(part) != std::string::npos; }

using Names = std::vector<std::string>;

}  // namespace calib::test
