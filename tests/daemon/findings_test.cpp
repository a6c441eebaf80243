#include "findings.hpp"

#include <algorithm>
#include <functional>
#include <nlohmann/json.hpp>

#include "control_codec.hpp"
#include "depth/depth_config.hpp"
#include "support/catch.hpp"
#include "support/healthy_pair.hpp"
#include "support/support.hpp"

using namespace calib;
using namespace std::chrono_literals;
using namespace calib::test;

TEST_CASE("every check of a healthy pair is ok") {
  for (const Finding& finding : diagnose(healthy())) {
    INFO(finding.check << ": " << finding.seen);
    CHECK(finding.result == FindingResult::ok);
    CHECK(finding.code.empty());
    CHECK_FALSE(finding.seen.empty());
  }
}

TEST_CASE("for a topic without publisher the nearest topic that is not in use is suggested") {
  PairObservation seen = healthy();
  silence(seen, "cloud");
  CHECK(problems(seen) == Names{"cloud/no_publisher"});
  seen.writers.push_back({"/lidar/points", cloud_type_name, false, ""});
  seen.writers.push_back({"/points_raw", cloud_type_name, false, ""});
  seen.writers.push_back({"/pointz", "std_msgs/msg/String", false, ""});
  CHECK(problems(seen) == Names{"cloud/wrong_topic"});
  CHECK(holds(finding(seen, "cloud").remedy, "/points_raw as lidar.cloud"));
  CHECK(finding(seen, "pairing").result == FindingResult::not_checked);
  seen.topics_in_use = {"/lidar/points", "/points_raw"};
  CHECK(problems(seen) == Names{"cloud/no_publisher"});
  seen.writers.clear();
  CHECK(finding(seen, "cloud").code == "nobody_heard");
}

TEST_CASE("wrong type, incompatible QoS, silence and malformed messages are distinguished") {
  PairObservation seen = healthy();
  silence(seen, "image");
  seen.writers.push_back({"/left/image", cloud_type_name, true, ""});
  CHECK(problems(seen) == Names{"image/wrong_type"});
  CHECK(holds(finding(seen, "image").seen, cloud_type_name));
  seen.writers.back() = {"/left/image", "sensor_msgs/msg/CompressedImage", true, ""};
  CHECK(holds(finding(seen, "image").remedy, "/compressed"));
  seen.writers.back().type = "foxglove_msgs/msg/CompressedVideo";
  CHECK(holds(finding(seen, "image").cause, "a video stream"));
  seen.writers.back() = {"/left/image", image_type_name, true, "it publishes in the DDS partition 'night' only"};
  CHECK(problems(seen) == Names{"image/qos_mismatch"});
  seen.writers.back().obstacle.clear();
  CHECK(problems(seen) == Names{"image/silent"});
  find(seen, "image").malformed["malformed:encoding"] = 4;
  find(seen, "image").malformed_context = "encoding 'jpeg2000' is not supported";
  CHECK(problems(seen) == Names{"image/malformed:encoding"});
  find(seen, "image").messages = 3;
  CHECK(finding(seen, "image").result == FindingResult::warning);
}

TEST_CASE("two publishers of one topic are a warning") {
  PairObservation seen = healthy();
  seen.writers.push_back(seen.writers.front());
  CHECK(problems(seen).empty());
  CHECK(finding(seen, "image").code == "several_publishers");
}

TEST_CASE("a wrong clock is named, of one sensor or of all") {
  PairObservation seen = healthy();
  find(seen, "cloud").age = 61s;
  seen.time_difference = fail(ErrorCode::time_difference, "61 s apart");
  CHECK(problems(seen) == Names{"clock/stale_clock"});
  CHECK(holds(finding(seen, "clock").cause, "/points is not synchronised"));
  find(seen, "cloud").age = -5s;
  CHECK(problems(seen) == Names{"clock/clock_ahead"});
  for (TopicObservation& each : seen.topics) each.age = 24h * 400;
  CHECK(problems(seen) == Names{"clock/stale_clock"});
  CHECK(holds(finding(seen, "clock").cause, "recorded"));
  CHECK(holds(finding(seen, "clock").seen, "400 days behind"));
  seen = healthy();
  find(seen, "image").repeated_stamps = 19;
  CHECK(problems(seen) == Names{"clock/stamps_stand_still"});
}

TEST_CASE("samples that never form a pair are a problem of pairing") {
  PairObservation seen = healthy();
  seen.time_difference = fail(ErrorCode::time_difference, "image and point cloud are at least 80 ms apart");
  CHECK(problems(seen) == Names{"pairing/time_difference"});
  seen.time_difference = fail(ErrorCode::right_image_missing, "no right image has the stamp of a left one");
  CHECK(problems(seen) == Names{"pairing/right_image_missing"});
}

TEST_CASE("an image of another size is reported, and whether it is scaled") {
  PairObservation seen = healthy();
  seen.image = ImageSize{320, 96};
  CHECK(problems(seen) == Names{"image_size/image_size_mismatch"});
  CHECK(holds(finding(seen, "image_size").cause, "scaled by 0.5"));
  CHECK(holds(finding(seen, "image_size").remedy, "[320, 96]"));
  seen.image = ImageSize{640, 200};
  CHECK_FALSE(holds(finding(seen, "image_size").cause, "scaled"));
}

TEST_CASE("images of another size, which are not decoded, are not a problem of pairing") {
  PairObservation seen = healthy();
  seen.image = ImageSize{320, 96};
  seen.time_difference = fail(ErrorCode::sensor_silent, "no image arrived");
  seen.depth = fail(ErrorCode::no_pair, "there is no pair");
  CHECK(problems(seen) == Names{"image_size/image_size_mismatch"});
  CHECK(finding(seen, "pairing").result == FindingResult::not_checked);
  seen.image = ImageSize{640, 192};
  seen.companion_mismatch = "/right/image: the image is 6 x 4, and depth.right_camera.size is 7 x 4";
  CHECK(problems(seen) == Names{"image_size/image_size_mismatch"});
  CHECK(holds(finding(seen, "image_size").seen, "depth.right_camera.size is 7 x 4"));
}

TEST_CASE("a lens that contradicts CameraInfo is a problem") {
  PairObservation seen = healthy();
  seen.camera = require_ok(Camera::make(CameraModel::equidistant, 640, 192, {370, 370, 320, 90}, {0, 0, 0, 0}));
  CHECK(problems(seen) == Names{"lens/wrong_lens_model"});
  CHECK(holds(finding(seen, "lens").remedy, "rectified"));
  seen.camera_info->D = {-0.3, 0.1, 0, 0, 0};
  CHECK(holds(finding(seen, "lens").remedy, "model: plumb_bob"));
  seen = healthy();
  seen.camera_info->P[0] = 400;
  CHECK(problems(seen) == Names{"lens/intrinsics_mismatch"});
  seen = healthy();
  seen.camera_info->width = 1280;
  CHECK(problems(seen) == Names{"lens/camera_info_mismatch"});
  seen.camera_info = {};
  CHECK(finding(seen, "lens").result == FindingResult::not_checked);
}

TEST_CASE("raw images with a rectified lens are a problem if depth confirms it, otherwise a warning") {
  PairObservation seen = healthy();
  seen.camera_info->D = {-0.3, 0.1, 0, 0, 0};
  CHECK(finding(seen, "lens").result == FindingResult::warning);
  seen.info_agreement = DepthAgreement{0.97, 1, 15000};
  CHECK(problems(seen) == Names{"lens/wrong_lens_model"});
  seen.info_agreement = DepthAgreement{0.7, 1, 15000};
  find(seen, "image").topic = "/left/image_rect";
  seen.writers.front().topic = "/left/image_rect";
  CHECK(finding(seen, "lens").result == FindingResult::ok);
}

TEST_CASE("the unit of a cloud is recognised by its ranges or by metric depth") {
  PairObservation seen = healthy();
  const auto unit = [&](double median_range, std::uint64_t too_far) {
    seen.cloud = CloudStatistics{60000, 100, 0, too_far, median_range};
    CHECK(problems(seen) == Names{"cloud_range/cloud_unit"});
    return finding(seen, "cloud_range").cause;
  };
  CHECK(holds(unit(11500, 59000), "millimetres"));
  CHECK(holds(unit(1150, 52000), "centimetres"));
  CHECK(holds(unit(0.0115, 0), "kilometres"));
  seen = healthy();
  seen.extrinsic->agreement->scale = 3.3;
  CHECK(problems(seen) == Names{"agreement/cloud_unit"});
  CHECK(holds(finding(seen, "agreement").cause, "feet"));
  seen.extrinsic->agreement->scale = 1.6;
  CHECK(finding(seen, "agreement").code == "depth_scale");
  seen.depth_kind = OnnxDepthConfig::kind;
  CHECK(finding(seen, "agreement").result == FindingResult::ok);
  seen.cloud = CloudStatistics{60000, 1000, 59000, 0, 0};
  CHECK(problems(seen) == Names{"cloud_range/empty_cloud"});
}

TEST_CASE("ordinary clouds, of a car park or of a motorway, are in metres") {
  PairObservation seen = healthy();
  for (const double median_range : {2.0, 5.0, 30.0, 90.0}) {
    seen.cloud = CloudStatistics{60000, 100, 5000, 0, median_range};
    CHECK(problems(seen).empty());
  }
}

TEST_CASE("exchanged stereo images are recognised") {
  PairObservation seen = healthy();
  seen.depth = DepthTrial{0.08, {}};
  seen.extrinsic->agreement = DepthAgreement{0.1, 0.4, 500};
  CHECK(problems(seen) == Names{"depth/few_valid_depth"});
  seen.swapped = DepthTrial{0.6, DepthAgreement{0.9, 1, 15000}};
  CHECK(problems(seen) == Names{"depth/stereo_swapped"});
}

TEST_CASE("a misread extrinsic is reported with the likely right one") {
  PairObservation seen = healthy();
  seen.extrinsic->agreement = DepthAgreement{0.1, 1, 500};
  seen.extrinsic->likely = ExtrinsicReading{"inverse", "it looks like the inverse", RigidTransform::Identity()};
  seen.extrinsic->likely_agreement = DepthAgreement{0.9, 1, 15000};
  CHECK(problems(seen) == Names{"extrinsic/extrinsic_inverse"});
  CHECK(holds(finding(seen, "extrinsic").remedy, "quaternion_xyzw: [0.000000, 0.000000, 0.000000, 1.000000]"));
  seen.extrinsic->likely = {};
  seen.extrinsic->sees_nothing = true;
  CHECK(problems(seen) == Names{"extrinsic/extrinsic_out_of_view"});
}

TEST_CASE("inverted, unrelated, weak and failed depth and a wrong lens are distinguished") {
  PairObservation seen = healthy();
  seen.depth_kind = OnnxDepthConfig::kind;
  const auto with = [&](double correlation) {
    seen.extrinsic->agreement->rank_correlation = correlation;
    return finding(seen, "agreement");
  };
  CHECK(with(-0.85).code == "depth_inverted");
  CHECK(holds(with(-0.85).remedy, "semantics"));
  CHECK(with(0.05).code == "depth_unrelated");
  CHECK(with(0.4).result == FindingResult::warning);
  seen.info_agreement = DepthAgreement{0.9, 1, 15000};
  CHECK(with(0.2).code == "wrong_lens_model");
  seen.depth = fail(ErrorCode::depth_failed, "the model is not the one that was pinned");
  CHECK(problems(seen) == Names{"depth/depth_failed"});
  CHECK(with(0.2).result == FindingResult::not_checked);
  seen.depth = fail(ErrorCode::depth_model_refused, "its SHA-256 is not the one that is pinned");
  CHECK(problems(seen) == Names{"depth/depth_model_refused"});
  CHECK(holds(finding(seen, "depth").cause, "altered"));
}

TEST_CASE("a dark scene is a warning") {
  PairObservation seen = healthy();
  seen.scene = Error{ErrorCode::dark, "mean grey is 4.00, the limit is 20.00"};
  CHECK(problems(seen).empty());
  CHECK(finding(seen, "scene").code == "dark");
}

TEST_CASE("a pair without any message has problems, and none of its checks is ok") {
  PairObservation seen = healthy();
  for (const char* check : {"image", "right_image", "cloud", "camera_info"}) silence(seen, check);
  seen.image = {}, seen.camera_info = {}, seen.cloud = {}, seen.extrinsic = {};
  seen.depth = fail(ErrorCode::no_pair, "there is no pair of samples to compute it from");
  for (const Finding& finding : diagnose(seen)) CHECK(finding.result != FindingResult::ok);
  CHECK(problems(seen) ==
        Names{"image/nobody_heard", "right_image/nobody_heard", "cloud/nobody_heard", "camera_info/nobody_heard"});
}

TEST_CASE("untrusted names are bounded, and escaped in JSON") {
  PairObservation seen = healthy();
  silence(seen, "cloud");
  seen.writers.push_back({"dds:" + std::string(5000, 'x') + "\x1b[31m", cloud_type_name, true, ""});
  seen.writers.push_back({"/points", "\x1b[31mtype", true, ""});
  const auto reply =
      encode_reply(DiagnosisReport{.checks = {{"front", finding(seen, "cloud")}, {"front", finding(seen, "image")}},
                                   .overlays = {{"front", "/a.png"}}});
  const auto& json = reply["checks"][0];
  CHECK(json["code"] == "wrong_type");
  CHECK(json["check"] == "cloud");
  CHECK(json["pair"] == "front");
  CHECK(json.dump().find("\\u001b") == std::string::npos);
  CHECK(json.dump().size() < 1000);
  CHECK_FALSE(reply["checks"][1].contains("code"));
  CHECK(reply["ok"] == true);
  CHECK(reply["overlays"][0] == nlohmann::json{{"pair", "front"}, {"file", "/a.png"}});
}
