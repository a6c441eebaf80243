#pragma once

#include <chrono>
#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "calib/geometry.hpp"
#include "calib/quality.hpp"
#include "calib/result.hpp"
#include "dds/names.hpp"
#include "depth/depth_config.hpp"

namespace calib {

/// /etc/calibd/calibd.yaml as values: SI units, topics as ROS 2 names. Every key, its unit and its default
/// are explained in systemd/calibd.yaml.

struct DdsConfig {
  std::uint32_t domain = 0;
  std::string interface = "auto";
};

/// Every `period` the sensors are read for at most `window`; an image and a scan make a pair when their
/// stamps differ by no more than `max_time_difference`.
struct SamplingConfig {
  std::chrono::nanoseconds period = std::chrono::seconds(10);
  std::chrono::nanoseconds window = std::chrono::seconds(2);
  std::chrono::nanoseconds max_time_difference = std::chrono::milliseconds(50);
};

struct CameraConfig {
  std::string image;
  /// A CameraInfo topic whose intrinsics must agree with `camera`.
  std::optional<std::string> info;
  std::string frame_id = "camera_optical";
  Camera camera;
};

struct LidarConfig {
  std::string cloud;
  std::string frame_id = "lidar";
  /// A cloud of more is refused.
  std::uint64_t max_points = 1'000'000;
};

/// Pairs in whose time difference the vehicle turned further are not evaluated.
struct MotionConfig {
  MotionTopic topic;
  double max_turn_rad = 0;
};

struct DriftConfig {
  int baseline_pairs = 20;
  /// What chance alone may raise, over all pairs of a vehicle that drives so many hours a week.
  double false_alerts_per_1000_vehicle_weeks = 1, driving_hours_per_week = 56;
  /// A pair whose evidence cannot be trusted to show so much is not judged.
  double must_detect_rad = 0.5 * radians_per_degree;
};

/// `apply` puts an accepted extrinsic in force; `propose` waits for `calibctl accept`.
enum class RecalibrationMode { apply, propose };

struct RecalibrationConfig {
  RecalibrationMode mode = RecalibrationMode::propose;
  int frames = 25;
  double max_rotation_rad = 5 * radians_per_degree;
  double max_translation_m = 0.5;
  /// From one recalibration to the next that nobody asked for; doubled with each that was refused.
  std::chrono::nanoseconds min_interval = std::chrono::minutes(10);
};

struct PairConfig {
  std::string name;
  CameraConfig camera;
  LidarConfig lidar;
  RigidTransform T_camera_lidar = RigidTransform::Identity();
  DepthConfig depth;
  DepthRange depth_range;
  /// An estimate, or the preparation of its source, that takes longer is ended.
  std::chrono::nanoseconds depth_timeout = std::chrono::seconds(30);
  std::optional<MotionConfig> motion = {};
  DriftConfig drift;
  RecalibrationConfig recalibration;
  /// All of the configuration that evidence depends on, in one text: vehicle, network, sensors, lens, depth source.
  std::string evidence_text = {};
};

struct Config {
  std::string vehicle;
  std::filesystem::path state_dir;
  /// Where the head of the chain of records is remembered, away from the records.
  std::filesystem::path head_dir;
  std::filesystem::path runtime_dir;
  DdsConfig dds;
  std::filesystem::path signing_key;
  SamplingConfig sampling;
  std::vector<PairConfig> pairs;
  /// Of the file's bytes, lower-case hex: what a record says it was computed under.
  std::string sha256;
};

/// `DriftSettings::false_alarms_per_pair` as the configuration wants it: alerts per 1000 vehicle-weeks, of which each
/// has a sample every period of the hours driven, shared among the vehicle's pairs.
[[nodiscard]] double false_alarms_per_pair(const Config& config, const DriftConfig& drift);

/// How long evidence carries a verdict: until the second window after it has closed, at least five seconds. `cycle` is
/// the time that a round of all pairs really takes, which may be longer than the period.
[[nodiscard]] std::chrono::nanoseconds evidence_lifetime(const SamplingConfig& sampling,
                                                         std::chrono::nanoseconds cycle);

/// Where the service manager put things ($STATE_DIRECTORY, $RUNTIME_DIRECTORY, $CREDENTIALS_DIRECTORY):
/// defaults for the keys that the file does not give.
struct Places {
  std::optional<std::filesystem::path> state{}, runtime{}, credentials{}, head{};
};

/// Fails with `bad_config` and one line `FILE:LINE: pairs[0].camera.size: what is wrong; what to write`, for
/// the first thing that is: YAML that does not parse; an unknown, repeated or missing key; a wrong type; a
/// value out of range.
[[nodiscard]] Result<Config> parse_config(std::string_view yaml, const std::filesystem::path& file,
                                          const Places& places);

/// `parse_config` of a file of at most 1 MiB. Fails also with `config_not_found`.
[[nodiscard]] Result<Config> load_config(const std::filesystem::path& file, const Places& places);

}  // namespace calib
