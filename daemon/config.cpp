#include "config.hpp"

#include <algorithm>

#include "calib/config_node.hpp"
#include "calib/record.hpp"
#include "config_values.hpp"
#include "dds/decode.hpp"
#include "dds/names.hpp"

namespace calib {
namespace {

using namespace std::chrono_literals;
constexpr std::size_t max_pairs = 16, max_peers = 32;
/// Nearer depth belongs to the vehicle itself or is a false match. Stereo and depth cameras of vehicles do not resolve
/// depth further away.
constexpr DepthRange metric_depth_range{0.5, 200};

void read_frame_id(const ConfigNode& node, FrameName& frame) {
  constexpr std::string_view marks = "ABCDEFGHIJKLMNOPQRSTUVWXYZ_-/";
  const std::string name = node.text();
  if (!is_name(name, marks)) node.refuse("a frame is named with 1 .. 64 letters, digits, _ - and /");
  frame.name = name;
  frame.is_given = true;
}

std::filesystem::path path_or(const ConfigNode& top, std::string_view key,
                              const std::optional<std::filesystem::path>& fallback) {
  if (!fallback || top.find(key)) return read_absolute_path(top.at(key));
  return *fallback;
}

/// Without `.`, `..` and a slash at the end.
std::filesystem::path normalized(const std::filesystem::path& folder) {
  const auto normal = folder.lexically_normal();
  return normal.has_filename() ? normal : normal.parent_path();
}

DdsConfig read_dds(const ConfigNode& node) {
  node.with_keys({"domain", "interface", "multicast", "peers"});
  DdsConfig dds;
  if (const auto domain = node.find("domain")) dds.domain = static_cast<std::uint32_t>(domain->integer(0, 230));
  if (const auto interface = node.find("interface")) {
    dds.interface = interface->text();
    if (!is_interface_name(dds.interface)) interface->refuse("needs a network interface such as lo or eth0, or auto");
  }
  if (const auto multicast = node.find("multicast")) dds.multicast = multicast->boolean();
  if (const auto peers = node.find("peers")) {
    const auto items = peers->items();
    if (items.size() > max_peers)
      peers->refuse("has " + std::to_string(items.size()) + " addresses where 32 are allowed");
    for (const ConfigNode& item : items) {
      dds.peers.push_back(item.text());
      if (!is_peer_address(dds.peers.back())) item.refuse("needs a host name or an address such as 192.168.1.7");
    }
  }
  if (!dds.multicast && dds.peers.empty())
    node.at("multicast").refuse("is false, so that peers must say whom calibd tells its presence");
  return dds;
}

SamplingConfig read_sampling(const ConfigNode& node) {
  node.with_keys({"period", "window", "max_time_difference"});
  SamplingConfig sampling;
  if (const auto period = node.find("period")) sampling.period = period->duration(100ms, 24h);
  if (const auto window = node.find("window"))
    sampling.window = window->duration(50ms, sampling.period);
  else
    sampling.window = std::min(sampling.window, sampling.period);
  if (const auto difference = node.find("max_time_difference"))
    sampling.max_time_difference = difference->duration(0ms, 1s);
  return sampling;
}

InfoReduction read_reduction(const ConfigNode& node) {
  const std::string name = node.text();
  if (name == "as_specified") return InfoReduction::as_specified;
  if (name == "ignored") return InfoReduction::ignored;
  if (name != "size_only") node.refuse("is none of: as_specified, ignored, size_only");
  return InfoReduction::size_only;
}

CameraConfig read_camera(const ConfigNode& node) {
  node.with_keys({"image", "info", "info_reduction", "frame_id", "bits", "model", "size", "intrinsics", "distortion"});
  CameraConfig camera{.image = read_topic(node.at("image")), .info = {}, .camera = read_camera_model(node)};
  if (const auto info = node.find("info")) camera.info = CameraInfoTopic{.name = read_topic(*info)};
  if (const auto reduction = node.find("info_reduction")) {
    if (!camera.info) reduction->refuse("is about info, which is not given");
    camera.info->reduction = read_reduction(*reduction);
  }
  if (const auto frame = node.find("frame_id")) read_frame_id(*frame, camera.frame_id);
  if (const auto bits = node.find("bits")) camera.bits = bits->integer(8, 16);
  return camera;
}

LidarConfig read_lidar(const ConfigNode& node) {
  node.with_keys({"cloud", "frame_id", "max_points"});
  LidarConfig lidar{.cloud = read_topic(node.at("cloud"))};
  if (const auto frame = node.find("frame_id")) read_frame_id(*frame, lidar.frame_id);
  if (const auto points = node.find("max_points"))
    lidar.max_points = static_cast<std::uint64_t>(points->integer(1000, static_cast<int>(max_cloud_points)));
  return lidar;
}

void read_depth(const ConfigNode& node, PairConfig& pair) {
  pair.depth = read_depth_config(node, pair.camera);
  if (depth_kind(pair.depth).is_metric) pair.depth_range = metric_depth_range;
  if (const auto range = node.find("range_m")) {
    const auto limits = range->numbers(2, 0, 1000);
    if (limits[0] >= limits[1]) range->refuse("needs the least depth before the greatest");
    pair.depth_range = {limits[0], limits[1]};
  }
  if (const auto timeout = node.find("timeout")) pair.depth_timeout = timeout->duration(100ms, 60s);
}

MotionConfig read_motion(const ConfigNode& node) {
  node.with_keys({"topic", "type", "max_turn_deg"});
  MotionConfig motion{.topic = {.name = read_topic(node.at("topic"))}, .max_turn_rad = QualityLimits{}.max_turn_rad};
  const ConfigNode type = node.at("type");
  const std::string name = type.text();
  if (name != "imu" && name != "odometry") type.refuse("is none of: imu, odometry");
  motion.topic.message = name == "imu" ? MotionMessage::imu : MotionMessage::odometry;
  if (const auto limit = node.find("max_turn_deg")) motion.max_turn_rad = limit->number(0.01, 10) * radians_per_degree;
  return motion;
}

DriftConfig read_drift(const ConfigNode& node) {
  node.with_keys({"baseline_pairs", "false_alerts_per_1000_vehicle_weeks", "driving_hours_per_week", "must_notice_deg",
                  "notice_within", "min_scene_change"});
  DriftConfig drift;
  if (const auto rate = node.find("false_alerts_per_1000_vehicle_weeks"))
    drift.false_alerts_per_1000_vehicle_weeks = rate->number(0.001, 100'000);
  if (const auto hours = node.find("driving_hours_per_week")) drift.driving_hours_per_week = hours->number(1, 168);
  if (const auto shift = node.find("must_notice_deg"))
    drift.must_detect_rad = shift->number(0.1, 5) * radians_per_degree;
  if (const auto time = node.find("notice_within")) drift.notice_within = time->duration(10min, 168h);
  if (const auto change = node.find("min_scene_change")) drift.min_scene_change = change->number(0, 1);
  if (const auto pairs = node.find("baseline_pairs")) drift.baseline_pairs = pairs->integer(5, 1000);
  return drift;
}

RecalibrationConfig read_recalibration(const ConfigNode& node) {
  node.with_keys({"mode", "frames", "max_rotation_deg", "max_translation_cm", "min_interval"});
  RecalibrationConfig recalibration;
  if (const auto mode = node.find("mode")) {
    const std::string name = mode->text();
    if (name != "apply" && name != "propose") mode->refuse("is none of: apply, propose");
    recalibration.mode = name == "apply" ? RecalibrationMode::apply : RecalibrationMode::propose;
  }
  if (const auto frames = node.find("frames")) recalibration.frames = frames->integer(8, 100);
  if (const auto limit = node.find("max_rotation_deg"))
    recalibration.max_rotation_rad = limit->number(0.1, 30) * radians_per_degree;
  if (const auto limit = node.find("max_translation_cm")) recalibration.max_translation_m = limit->number(1, 500) / 100;
  if (const auto interval = node.find("min_interval")) recalibration.min_interval = interval->duration(0ms, 24h);
  return recalibration;
}

/// Left out: the extrinsic, since records tie evidence to it, and settings that affect only what follows from evidence.
std::string evidence_text(const ConfigNode& pair) {
  std::string text;
  for (const char* key : {"camera", "lidar", "depth", "motion"})
    if (const auto node = pair.find(key)) text += std::string(key) + ':' + node->canonical() + '\n';
  if (const auto recalibration = pair.find("recalibration"))  // features depend on these bounds
    for (const char* key : {"max_rotation_deg", "max_translation_cm"})
      if (const auto node = recalibration->find(key)) text += std::string(key) + ':' + node->canonical() + '\n';
  if (const auto drift = pair.find("drift"))  // decides which pairs are evidence
    if (const auto node = drift->find("min_scene_change")) text += "min_scene_change:" + node->canonical() + '\n';
  return text;
}

PairConfig read_pair(const ConfigNode& node) {
  node.with_keys({"name", "camera", "lidar", "T_camera_lidar", "depth", "motion", "drift", "recalibration"});
  PairConfig pair{.name = node.at("name").text(),
                  .camera = read_camera(node.at("camera")),
                  .lidar = read_lidar(node.at("lidar")),
                  .T_camera_lidar = read_transform(node.at("T_camera_lidar")),
                  .depth = {},
                  .depth_range = {},
                  .drift = {},
                  .recalibration = {}};
  read_depth(node.at("depth"), pair);
  if (!is_name(pair.name, "_-")) node.at("name").refuse("a pair is named with 1 .. 64 of a-z, 0-9, _ and -");
  if (const auto motion = node.find("motion")) pair.motion = read_motion(*motion);
  if (const auto drift = node.find("drift")) pair.drift = read_drift(*drift);
  if (const auto recalibration = node.find("recalibration")) pair.recalibration = read_recalibration(*recalibration);
  pair.evidence_text = evidence_text(node);
  return pair;
}

std::vector<PairConfig> read_pairs(const ConfigNode& node) {
  const auto items = node.items();
  if (items.empty() || items.size() > max_pairs) node.refuse("needs 1 .. 16 pairs");
  std::vector<PairConfig> pairs;
  for (const ConfigNode& item : items) {
    PairConfig pair = read_pair(item);
    if (std::ranges::find(pairs, pair.name, &PairConfig::name) != pairs.end())
      item.at("name").refuse("is the name of an earlier pair; every pair needs its own");
    pairs.push_back(std::move(pair));
  }
  return pairs;
}

Config read_config(const ConfigNode& top, const DefaultFolders& defaults) {
  top.with_keys({"vehicle", "state_dir", "head_dir", "runtime_dir", "dds", "signing_key", "sampling", "pairs"});
  Config config;
  config.vehicle = top.at("vehicle").text();
  if (!is_name(config.vehicle, "ABCDEFGHIJKLMNOPQRSTUVWXYZ_-.:"))
    top.at("vehicle").refuse("a vehicle is named with 1 .. 64 letters, digits, _ - . and :");
  config.state_dir = path_or(top, "state_dir", defaults.state);
  config.head_dir = path_or(top, "head_dir", defaults.head ? *defaults.head : normalized(config.state_dir) += "-head");
  if (normalized(config.head_dir) == normalized(config.state_dir))
    top.at("head_dir").refuse("needs another folder than state_dir, so that the loss of one is detected by the other");
  config.runtime_dir = path_or(top, "runtime_dir", defaults.runtime);
  std::optional<std::filesystem::path> credential;
  if (defaults.credentials) credential = *defaults.credentials / "signing.key";
  config.signing_key = path_or(top, "signing_key", credential);
  config.signing_key_is_given = top.find("signing_key").has_value();
  if (const auto dds = top.find("dds")) config.dds = read_dds(*dds);
  if (const auto sampling = top.find("sampling")) config.sampling = read_sampling(*sampling);
  config.pairs = read_pairs(top.at("pairs"));
  for (PairConfig& pair : config.pairs)
    pair.evidence_text += "vehicle:" + config.vehicle + "\ndomain:" + std::to_string(config.dds.domain) +
                          "\nmax_time_difference_ns:" + std::to_string(config.sampling.max_time_difference.count()) +
                          '\n';
  return config;
}

/// The values that systemd/calibd.yaml and README.md show: nobody's vehicle. A demonstration has an extrinsic of its
/// own.
bool is_untouched_example(const Config& config) {
  if (config.vehicle != "demo-car" || config.pairs.size() != 1) return false;
  const PairConfig& pair = config.pairs.front();
  return pair.camera.image == "/camera/left/image" && pair.lidar.cloud == "/lidar/points" &&
         pair.T_camera_lidar.translation().isZero();
}

}  // namespace

double false_alarms_per_pair(const Config& config, const DriftConfig& drift) {
  const double samples_per_week =
      drift.driving_hours_per_week * 3600 / std::chrono::duration<double>(config.sampling.period).count();
  // Beyond one in a hundred the charts have no limits.
  return std::min(0.01, drift.false_alerts_per_1000_vehicle_weeks / 1000 / samples_per_week /
                            static_cast<double>(config.pairs.size()));
}

std::chrono::nanoseconds evidence_lifetime(const SamplingConfig& sampling, std::chrono::nanoseconds cycle) {
  return std::max<std::chrono::nanoseconds>(2 * std::max(sampling.period, cycle) + sampling.window, 5s);
}

Result<Config> parse_config(std::string_view yaml, const std::filesystem::path& file, const DefaultFolders& defaults) {
  Config config;
  const auto read = parse_config_text(yaml, file, [&](const ConfigNode& top) {
    config = read_config(top, defaults);
    config.values = top.values();
  });
  if (!read) return propagate(read);
  config.sha256 = sha256_hex(yaml);
  return config;
}

Result<Config> load_config(const std::filesystem::path& file, const DefaultFolders& defaults) {
  const auto yaml = read_config_text(file);
  if (!yaml) return fail(yaml.error().code, yaml.error().context + "; give the file with --config FILE");
  auto config = parse_config(*yaml, file, defaults);
  if (config && is_untouched_example(*config))
    return fail(ErrorCode::bad_config, file.string() +
                                           ": these are still the example's values; write your vehicle's name, topics, "
                                           "camera and extrinsic, and check them with `calibctl check-config`");
  return config;
}

}  // namespace calib
