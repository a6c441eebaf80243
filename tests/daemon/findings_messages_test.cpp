#include "findings.hpp"
#include "message_faults.hpp"
#include "support/catch.hpp"
#include "support/healthy_pair.hpp"
#include "support/support.hpp"

using namespace calib;
using namespace calib::test;

TEST_CASE("a label alone of another lens is a warning; depth decides") {
  PairObservation seen = healthy();
  seen.camera = require_ok(Camera::make(CameraModel::equidistant, 640, 192, {370, 370, 320, 90}, {0.01, 0, 0, 0}));
  seen.camera_info->D = {0.01, 0, 0, 0, 0};  // as plumb_bob
  seen.info_agreement = DepthAgreement{0.6, 1, 15000};
  CHECK(problems(seen).empty());
  CHECK(finding(seen, "lens").result == FindingResult::warning);
  CHECK(holds(finding(seen, "lens").seen, "no better with that lens (0.60) than with the configured one (0.90)"));
  CHECK(holds(finding(seen, "lens").cause, "names the model of its lens wrongly"));
  seen.extrinsic->agreement->rank_correlation = 0.5;
  CHECK(problems(seen) == Names{"lens/wrong_lens_model"});
}

TEST_CASE("a zero P falls back to K, and binning is told with the raw values") {
  PairObservation seen = healthy();
  seen.camera_info->P = {};
  CHECK(finding(seen, "lens").result == FindingResult::ok);
  seen = healthy();
  seen.camera_info->width = 320, seen.camera_info->height = 96;
  seen.camera_info->reduced_from = "640 x 192 with binning 2 x 2";
  CHECK(problems(seen) == Names{"lens/camera_info_mismatch"});
  CHECK(holds(finding(seen, "lens").seen, "320 x 96 pixels (640 x 192 with binning 2 x 2), camera.size is 640 x 192"));
  CHECK(holds(finding(seen, "lens").cause, "applies binning or roi"));
  CHECK(holds(finding(seen, "lens").remedy, "write camera.info_reduction: ignored"));
  seen = healthy();
  seen.camera_info->reduced_from = "1280 x 384 with binning 2 x 2";
  for (const int i : {0, 2, 4, 5}) seen.camera_info->K[i] /= 2;
  for (const int i : {0, 2, 5, 6}) seen.camera_info->P[i] /= 2;
  CHECK(problems(seen) == Names{"lens/intrinsics_mismatch"});
  CHECK(holds(finding(seen, "lens").cause, "beside a binning or roi"));
  CHECK(holds(finding(seen, "lens").remedy, "write camera.info_reduction: size_only"));
}

TEST_CASE("what was wrong in messages that were used is a warning with its value and remedy") {
  PairObservation seen = healthy();
  find(seen, "cloud").remarks["malformed:row_step"] = {ErrorCode::malformed_row_step, "row_step is 0, and so on"};
  CHECK(problems(seen).empty());
  CHECK(finding(seen, "cloud").code == "malformed:row_step");
  CHECK(holds(finding(seen, "cloud").seen, "row_step is 0"));
  CHECK(finding(seen, "cloud").remedy == message_fault(ErrorCode::malformed_row_step).remedy);
}

TEST_CASE("frames that the sensors do not have are named beside theirs") {
  PairObservation seen = healthy();
  CHECK(finding(seen, "frames").seen == "image: 'camera_optical', cloud: 'lidar'");
  find(seen, "image").frame_id = "cam_front/optical", find(seen, "cloud").frame_id = "os_lidar";
  CHECK(finding(seen, "frames").result == FindingResult::ok);  // the configuration gives none
  seen.camera_frame = {"camera_optical", "camera.frame_id", true};
  seen.lidar_frame = {"lidar", "lidar.frame_id", true};
  const Finding differing = finding(seen, "frames");
  CHECK((differing.result == FindingResult::warning && differing.code == "frame_id_mismatch"));
  for (const char* name : {"cam_front/optical", "os_lidar", "camera_optical", "'lidar'"})
    CHECK(holds(differing.seen, name));
  CHECK(holds(differing.remedy, "leave camera.frame_id and lidar.frame_id out"));
  find(seen, "image").frame_id = find(seen, "cloud").frame_id = "";
  CHECK(finding(seen, "frames").result == FindingResult::not_checked);
}

TEST_CASE("a camera of fewer bits and negative disparities are told from darkness and from missing depth") {
  PairObservation seen = healthy();
  seen.scene = Error{ErrorCode::dark, "mean grey is 4.00, the limit is 20.00"};
  find(seen, "image").remarks["image_bits"] = {ErrorCode::image_bits, "its values of 16 bits stay below 4096"};
  CHECK(finding(seen, "scene").code == "image_bits");
  CHECK(holds(finding(seen, "scene").remedy, "camera.bits"));

  seen = healthy();
  seen.topics.push_back(topic("depth_topic", "depth.disparity", "/disparity", "stereo_msgs/msg/DisparityImage"));
  seen.writers.push_back({"/disparity", "stereo_msgs/msg/DisparityImage", true, ""});
  seen.depth = DepthTrial{0, {}};
  find(seen, "depth_topic").remarks["malformed:disparity_sign"] = {ErrorCode::malformed_disparity_sign,
                                                                   "24 disparities are negative and 0 positive"};
  CHECK(problems(seen) == Names{"depth/malformed:disparity_sign"});
  CHECK(holds(finding(seen, "depth").seen, "24 disparities are negative"));
}

TEST_CASE("a CameraInfo that nobody asked for is no problem when it cannot be used") {
  PairObservation seen = healthy();
  TopicObservation& info = find(seen, "camera_info");
  info.messages = 0;
  info.malformed["malformed:uncalibrated"] = 3;
  info.malformed_context = "the driver says that this camera is not calibrated";
  seen.camera_info = {};
  CHECK(problems(seen) == Names{"camera_info/malformed:uncalibrated"});
  CHECK(holds(finding(seen, "camera_info").remedy, "calibrate the camera"));
  info.configured = false;
  CHECK(problems(seen).empty());
  CHECK(finding(seen, "camera_info").result == FindingResult::warning);
}

TEST_CASE("a missing reflectance is said, and an empty sample judges nothing") {
  PairObservation seen = healthy();
  seen.has_reflectance = false;
  CHECK(holds(finding(seen, "cloud_range").seen, "without reflectance"));
  CHECK(finding(seen, "cloud_range").result == FindingResult::ok);
  seen.cloud = CloudStatistics{60000, 100, 0, 0, 0};
  CHECK(finding(seen, "cloud_range").result == FindingResult::not_checked);
}

TEST_CASE("publishers of messages that drivers have of their own are told what can be set") {
  PairObservation seen = healthy();
  const std::string cloud = find(seen, "cloud").topic;
  silence(seen, "cloud");
  seen.writers.push_back({cloud, "livox_ros_driver2/msg/CustomMsg", true, ""});
  CHECK(problems(seen) == Names{"cloud/wrong_type"});
  CHECK(holds(finding(seen, "cloud").remedy, "set xfer_format of the driver to 0 (PointCloud2)"));
  seen.writers.back().type = "velodyne_msgs/msg/VelodyneScan";
  CHECK(holds(finding(seen, "cloud").cause, "the sensor's packets"));
  seen.writers.back().type = "point_cloud_interfaces/msg/CompressedPointCloud2";
  CHECK(holds(finding(seen, "cloud").remedy, "republish it as raw"));
  // A topic of the right type is nearer at hand than a change of the driver.
  seen.writers.push_back({"/points_raw", cloud_type_name, true, ""});
  CHECK(holds(finding(seen, "cloud").remedy, "/points_raw as lidar.cloud"));
  seen.writers = {{cloud, "my_msgs/msg/Blob", true, ""}};
  CHECK(finding(seen, "cloud").cause == "it is another topic than the one that was meant");
}
