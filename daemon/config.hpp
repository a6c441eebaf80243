#pragma once

#include <chrono>
#include <filesystem>
#include <map>
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

// /etc/calibd/calibd.yaml as values: SI units, topics as ROS 2 names. systemd/calibd.yaml explains every key, its unit
// and its default.

struct DdsConfig {
  std::uint32_t domain = 0;
  std::string interface = "auto";
  /// Whether others are found by multicast, and the addresses to which calibd tells its presence besides.
  bool multicast = true;
  std::vector<std::string> peers = {};
};

/// Each `period` the topics are read for at most `window`. An image and a scan make a pair when their stamps differ by
/// `max_time_difference` or less.
struct SamplingConfig {
  std::chrono::nanoseconds period = std::chrono::seconds(10);
  std::chrono::nanoseconds window = std::chrono::seconds(2);
  std::chrono::nanoseconds max_time_difference = std::chrono::milliseconds(50);
};

/// The frame of a sensor in an extrinsic that is published.
struct FrameName {
  std::string name;
  std::string_view key;   // of the configuration
  bool is_given = false;  // there
  /// The one in the sensor's messages, unless the configuration gives one or none was seen.
  [[nodiscard]] const std::string& or_seen(const std::string& seen) const {
    return is_given || seen.empty() ? name : seen;
  }
};

struct CameraConfig {
  std::string image;
  /// Topic of the CameraInfo whose intrinsics must agree with `camera`.
  std::optional<CameraInfoTopic> info;
  FrameName frame_id{"camera_optical", "camera.frame_id"};
  /// Of the 16 in a value of mono16 and the like.
  int bits = 16;
  Camera camera;
};

struct LidarConfig {
  std::string cloud;
  FrameName frame_id{"lidar", "lidar.frame_id"};
  /// A cloud with more points is refused.
  std::uint64_t max_points = 1'000'000;
};

struct MotionConfig {
  MotionTopic topic;
  /// A pair is not evaluated if the vehicle turned further between its image and its scan.
  double max_turn_rad = 0;
};

struct DriftConfig {
  /// Nothing: as `usual_drift_settings` has it for the depth source.
  std::optional<int> baseline_pairs;
  /// Expected number of false alerts over all pairs of a vehicle that drives `driving_hours_per_week`.
  double false_alerts_per_1000_vehicle_weeks = 1, driving_hours_per_week = 56;
  /// A pair whose detection limit about any axis is greater is not evaluated.
  double must_detect_rad = 0.5 * radians_per_degree;
  /// Within so much driving: small shifts show in many pairs only.
  std::chrono::nanoseconds notice_within = std::chrono::hours(2);
  /// Pairs whose images differ by less are of the same scene, and one piece of evidence; 0: none are. Nothing: as of
  /// `baseline_pairs`.
  std::optional<double> min_scene_change;
};

/// What happens to an accepted extrinsic: `apply` puts it in force, `propose` waits for `calibctl accept`.
enum class RecalibrationMode { apply, propose };

struct RecalibrationConfig {
  RecalibrationMode mode = RecalibrationMode::propose;
  int frames = 25;
  double max_rotation_rad = 5 * radians_per_degree;
  double max_translation_m = 0.5;
  /// Between two automatic recalibrations. Doubled after each one that was rejected.
  std::chrono::nanoseconds min_interval = std::chrono::minutes(10);
};

struct PairConfig {
  std::string name;
  CameraConfig camera;
  LidarConfig lidar;
  RigidTransform T_camera_lidar = RigidTransform::Identity();
  DepthConfig depth;
  DepthRange depth_range;
  /// For an estimate of depth, and for the preparation of its source. Either is cancelled when it takes longer.
  std::chrono::nanoseconds depth_timeout = std::chrono::seconds(30);
  std::optional<MotionConfig> motion = {};
  DriftConfig drift;
  RecalibrationConfig recalibration;
  /// What evidence depends on, in one text: vehicle, network, sensors, lens, depth source and search bounds as
  /// configured. A digest of it tells whether old evidence may be used.
  std::string evidence_text = {};
};

struct Config {
  std::string vehicle;
  std::filesystem::path state_dir;
  /// Holds a copy of the last record's number and digest, apart from the records, so that their loss is detected.
  std::filesystem::path head_dir;
  std::filesystem::path runtime_dir;
  DdsConfig dds;
  std::filesystem::path signing_key;
  bool signing_key_is_given = false;  // in the file
  SamplingConfig sampling;
  std::vector<PairConfig> pairs;
  /// Of the file's bytes, lower-case hex. Each record names the configuration that it was computed under by it. After a
  /// reload that could take over only a part (config_reload.hpp), of both files' digests.
  std::string sha256;
  /// What the file says, by key.
  std::map<std::string, std::string> values;
};

/// `DriftSettings::false_alarms_per_pair` from the configured alerts per 1000 vehicle-weeks: these are shared equally
/// among the pairs of the vehicle and among the samples of a week, one each period while the vehicle drives.
[[nodiscard]] double false_alarms_per_pair(const Config& config, const DriftConfig& drift);

/// How long evidence supports a verdict: two periods and a window, at least five seconds. `cycle` is the measured time
/// between two windows of a pair; it replaces the period where it is longer.
[[nodiscard]] std::chrono::nanoseconds evidence_lifetime(const SamplingConfig& sampling,
                                                         std::chrono::nanoseconds cycle);

/// Folders from the service manager ($STATE_DIRECTORY, $RUNTIME_DIRECTORY, $CREDENTIALS_DIRECTORY): defaults for the
/// keys that the file does not have.
struct DefaultFolders {
  std::optional<std::filesystem::path> state = {}, runtime = {}, credentials = {}, head = {};
};

/// Fails with `bad_config` for the first error: YAML that does not parse; an unknown, repeated or missing key; a wrong
/// type; a value out of range. The error is one line, `FILE:LINE: pairs[0].camera.size: what is wrong; what to write`.
[[nodiscard]] Result<Config> parse_config(std::string_view yaml, const std::filesystem::path& file,
                                          const DefaultFolders& defaults);

/// `parse_config` of a file of at most 1 MiB. Fails also with `config_not_found`, and with `bad_config` for the values
/// of the example that is installed: name, topics and extrinsic as a whole.
[[nodiscard]] Result<Config> load_config(const std::filesystem::path& file, const DefaultFolders& defaults);

}  // namespace calib
