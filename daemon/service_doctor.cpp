#include <fmt/format.h>

#include <algorithm>

#include "calib/overlay.hpp"
#include "doctor.hpp"
#include "service.hpp"

namespace calib {
namespace {

using std::chrono::steady_clock;

/// A pair is listened to until every topic has brought enough, within these bounds.
constexpr std::chrono::milliseconds shortest_listening{500}, long_enough_for_a_pair{1500}, longest_listening{5000};
constexpr std::uint64_t enough_messages = 5;
/// Depth that is this good needs no other explanations. Exchanged stereo images match here and there by chance.
constexpr double good_agreement = 0.7, good_share = 0.3;

/// Where drivers publish what a camera says about itself: beside its image.
std::string info_beside(std::string image) {
  if (is_compressed_topic(image)) image.erase(image.rfind('/'));
  return image.substr(0, image.rfind('/') + 1) + "camera_info";
}

std::string type_name(const MessageType& type) { return ros_type_name(type.descriptor->m_typename); }

std::string image_type_name(const std::string& topic) {
  return type_name(is_compressed_topic(topic) ? compressed_image_type : image_type);
}

/// What is read of a pair, as `topics` say; what the configuration does not name is there by convention only.
std::vector<TopicSeen> topics_to_hear(const PairTopics& topics, const PairConfig& pair) {
  std::vector<TopicSeen> to_hear;
  const auto add = [&](const char* check, const char* key, const std::string& topic, const std::string& type) {
    to_hear.push_back({.check = check, .key = key, .topic = topic, .type = type});
  };
  add("image", "camera.image", topics.image, image_type_name(topics.image));
  if (topics.right_image)
    add("right_image", "depth.right_image", *topics.right_image, image_type_name(*topics.right_image));
  if (topics.depth) {
    const bool disparity = topics.depth->message == DepthMessage::disparity;
    add("depth_topic", disparity ? "depth.disparity" : "depth.image", topics.depth->name,
        type_name(disparity ? disparity_image_type : image_type));
  }
  if (topics.motion)
    add("motion_topic", "motion.topic", topics.motion->name,
        type_name(topics.motion->message == MotionMessage::imu ? imu_type : odometry_type));
  add("cloud", "lidar.cloud", topics.cloud, type_name(cloud_type));
  if (topics.right_camera_info)
    add("right_camera_info", "depth.right_info", *topics.right_camera_info, type_name(camera_info_type));
  if (topics.camera_info) {
    add("camera_info", "camera.info", *topics.camera_info, type_name(camera_info_type));
    to_hear.back().configured = pair.camera.info.has_value();
  }
  return to_hear;
}

/// Writes down what comes of each topic, and puts pairs together as the watch does.
class Ear {
 public:
  Ear(PairSeen& seen, PairBuffer buffer) : seen_(seen), buffer_(std::move(buffer)) {}

  void hear(Sample& sample, WallTime now) {
    std::visit([&](auto& each) { note(each, now); }, sample);
    while (auto pair = buffer_.take()) pair_ = std::move(*pair);
  }
  [[nodiscard]] bool heard_enough(steady_clock::duration listened) const {
    const auto is_heard = [&](const TopicSeen& topic) {
      const bool published = std::ranges::any_of(seen_.writers, [&](const RemoteWriter& writer) {
        return writer.topic == topic.topic && writer.type == topic.type && writer.obstacle.empty();
      });
      return !published || topic.messages >= enough_messages || !topic.malformed.empty();
    };
    return listened > (pair_ ? shortest_listening : long_enough_for_a_pair) &&
           std::ranges::all_of(seen_.topics, is_heard);
  }
  std::optional<FramePair> finish() {
    if (pair_)
      seen_.time_difference = pair_->time_difference();
    else
      seen_.time_difference = tl::unexpected(buffer_.why_none());
    return std::move(pair_);
  }

  std::optional<CameraInfo> right_camera_info;

 private:
  void note(LeftImage& left, WallTime now) {
    arrived("image", left.image.stamp, now);
    seen_.image = ImageSize{left.image.width, left.image.height};
    buffer_.add_image(std::move(left.image));
  }
  void note(RightImage& right, WallTime now) {
    arrived("right_image", right.image.stamp, now);
    buffer_.add_right_image(std::move(right.image));
  }
  void note(DecodedCloud& cloud, WallTime now) {
    arrived("cloud", cloud.stamp, now);
    seen_.cloud = cloud.census;
    buffer_.add_scan(std::move(cloud));
  }
  void note(DepthImage& depth, WallTime now) {
    arrived("depth_topic", depth.stamp, now);
    buffer_.add_depth(std::move(depth));
  }
  void note(TurnRate& rate, WallTime now) { arrived("motion_topic", rate.stamp, now); }
  void note(CameraInfo& info, WallTime now) {
    arrived("camera_info", info.stamp, now);
    seen_.camera_info = std::move(info);
  }
  void note(RightCameraInfo& right, WallTime now) {
    arrived("right_camera_info", right.info.stamp, now);
    right_camera_info = std::move(right.info);
  }
  void note(Malformed& malformed, WallTime now) {
    const auto topic = std::ranges::find(seen_.topics, malformed.topic, &TopicSeen::topic);
    if (topic == seen_.topics.end()) return;
    if (malformed.image) {  // as good as any message, but for its size
      arrived(topic->check, malformed.image->stamp, now);
      if (topic->check == "image")
        seen_.image = malformed.image->size;
      else
        seen_.companion_size = fmt::format("{}: {}", malformed.topic, malformed.error.context);
      return;
    }
    ++topic->malformed[std::string(to_string(malformed.error.code))];
    topic->malformed_context = malformed.error.context;
  }
  void arrived(std::string_view check, Timestamp stamp, WallTime now) {
    const auto topic = std::ranges::find(seen_.topics, check, &TopicSeen::check);
    if (topic == seen_.topics.end()) return;
    ++topic->messages;
    if (topic->last_stamp == stamp) ++topic->repeated_stamps;
    topic->last_stamp = stamp;
    const auto age = now - stamp;
    if (!topic->age || std::chrono::abs(age) < std::chrono::abs(*topic->age)) topic->age = age;
  }

  PairSeen& seen_;
  PairBuffer buffer_;
  std::optional<FramePair> pair_;
};

/// Under another name first, so that nobody sees half a picture.
Result<void> draw(const std::filesystem::path& file, const FramePair& pair, const RigidTransform& T_camera_lidar,
                  const Camera& camera, const DepthMap* depth) {
  std::error_code error;
  std::filesystem::create_directories(file.parent_path(), error);
  auto unfinished = file;
  unfinished.replace_extension(".new.png");
  if (auto written = write_overlay(unfinished, pair, camera, T_camera_lidar, depth); !written) return written;
  std::filesystem::rename(unfinished, file, error);
  if (error) return fail(ErrorCode::write_failed, file.string() + " cannot be written: " + error.message());
  return {};
}

/// The camera that CameraInfo tells of, where it is another than the configured one.
std::optional<Camera> told_camera(const PairSeen& seen) {
  if (!seen.camera_info) return std::nullopt;
  const CameraInfo& info = *seen.camera_info;
  auto told = Camera::make(info.model, info.width, info.height, {info.K[0], info.K[4], info.K[2], info.K[5]}, info.D);
  const bool same_size = info.width == seen.camera.width() && info.height == seen.camera.height();
  return told && same_size ? std::optional(std::move(*told)) : std::nullopt;
}

DepthTrial trial(const DepthMap& depth, const PairSeen& seen, const RigidTransform& T_camera_lidar,
                 const LidarScan& scan) {
  return {depth.valid_share(), depth_agreement(depth, seen.camera, T_camera_lidar, scan)};
}

bool is_good(const PairSeen& seen) {
  const auto& agreement = seen.extrinsic ? seen.extrinsic->agreement : std::nullopt;
  return seen.depth && seen.depth->valid_share >= good_share && agreement &&
         agreement->rank_correlation > good_agreement;
}

}  // namespace

/// Between two pairs, when nothing else uses the sources of depth. Of the pair of that name, or of all.
DiagnosisReport Service::diagnose_pairs(const std::optional<std::string>& name) {
  DiagnosisReport report;
  for (const auto& pair : pairs_)
    if ((!name || *name == pair->config->name) && !stopping()) examine(*pair, report);
  return report;
}

/// One pair, from what is on the network to what it means. Changes nothing of the watch.
void Service::examine(Pair& watch, DiagnosisReport& report) {
  const PairConfig& config = *watch.config;
  PairSeen seen{.camera = config.camera.camera};
  seen.pair = config.name;
  seen.depth_source = std::holds_alternative<StereoDepthConfig>(config.depth) ? "stereo"
                      : std::holds_alternative<OnnxDepthConfig>(config.depth) ? "onnx"
                                                                              : "topic";
  seen.depth_is_metric = seen.depth_source != "onnx";
  seen.domain = config_.dds.domain;
  seen.interface = config_.dds.interface;
  seen.min_valid_depth = QualityLimits{}.min_valid_depth;
  const auto listened = listen(watch, seen);
  if (!listened) seen.time_difference = propagate(listened);
  // A network is refused with or without images; other sources are made of what comes.
  if (const auto ready = watch.depth->prepare(); !ready && seen.depth_source == "onnx")
    seen.depth = fail(ErrorCode::depth_model_refused, ready.error().context);
  std::optional<DepthMap> depth;
  if (listened && *listened) depth = try_depth(watch, **listened, seen);
  auto findings = diagnose(seen);
  if (listened && *listened) {
    const auto file = config_.state_dir / "doctor" / (config.name + ".png");
    const auto drawn = draw(file, **listened, watch.state.T_camera_lidar, seen.camera, depth ? &*depth : nullptr);
    if (drawn)
      report.overlays.push_back({config.name, file.string()});
    else
      findings.push_back({"picture", FindingResult::warning, std::string(to_string(drawn.error().code)),
                          drawn.error().context, "state_dir is full or not writable",
                          "make room, or correct state_dir"});
  }
  for (Finding& finding : findings) report.checks.push_back({config.name, std::move(finding)});
}

/// Hears the pair's topics, and the CameraInfo beside its image; returns the last samples that belong together.
Result<std::optional<FramePair>> Service::listen(Pair& watch, PairSeen& seen) {
  PairTopics topics = watch.topics;
  if (!topics.camera_info) topics.camera_info = info_beside(topics.image);
  seen.topics = topics_to_hear(topics, *watch.config);
  for (const TopicSeen& topic : seen.topics) seen.claimed_topics.insert(topic.topic);
  for (const auto& other : pairs_) {  // a cloud may serve several pairs, an image belongs to one place
    seen.claimed_topics.insert(other->topics.image);
    if (other->topics.right_image) seen.claimed_topics.insert(*other->topics.right_image);
  }
  auto window = network_->open_window(topics);
  if (!window) return propagate(window);
  Ear ear(seen, PairBuffer(config_.sampling.max_time_difference,
                           {.right_image = topics.right_image.has_value(), .depth = topics.depth.has_value()}));
  const auto start = steady_clock::now();
  while (!stopping() && steady_clock::now() < start + longest_listening) {
    auto samples = (*window)->wait(std::chrono::milliseconds(200));
    if (!samples) return propagate(samples);
    for (Sample& sample : *samples) ear.hear(sample, surroundings_.clock().wall);
    [[maybe_unused]] const bool on = keep_going();
    seen.listened = steady_clock::now() - start;
    if (seen.listened < shortest_listening) continue;
    auto writers = network_->remote_writers();
    if (!writers) return propagate(writers);
    seen.writers = std::move(*writers);
    if (ear.heard_enough(seen.listened)) break;
  }
  if (watch.config->camera.info && seen.camera_info) watch.depth->hear_left(*seen.camera_info);
  if (ear.right_camera_info) watch.depth->hear_right(*ear.right_camera_info);
  return ear.finish();
}

/// Depth as the watch would have it, what the extrinsic makes of it, and where that is not good, other ways to take it.
std::optional<DepthMap> Service::try_depth(Pair& watch, const FramePair& pair, PairSeen& seen) {
  const RigidTransform& T_camera_lidar = watch.state.T_camera_lidar;
  const auto estimate = [&](const FramePair& of) {
    auto depth = watch.depth->estimate(of);
    if (depth)
      if (auto masked = mask_depth(of.image, watch.config->depth_range, *depth); !masked) depth = propagate(masked);
    return depth;
  };
  if (auto scene = check_pair(pair, seen.camera, nullptr, {});
      !scene && scene.error().code != ErrorCode::image_size_mismatch)
    seen.scene = scene.error();
  if (seen.image != ImageSize{seen.camera.width(), seen.camera.height()}) return std::nullopt;
  auto depth = estimate(pair);
  if (depth)
    seen.depth = trial(*depth, seen, T_camera_lidar, pair.scan);
  else if (seen.depth || seen.depth.error().code == ErrorCode::no_pair)
    seen.depth = propagate(depth);
  seen.extrinsic = examine_extrinsic(seen.camera, T_camera_lidar, pair.scan, depth ? &*depth : nullptr);
  [[maybe_unused]] const bool on = keep_going();
  if (depth)
    if (const auto told = told_camera(seen)) seen.told_lens = depth_agreement(*depth, *told, T_camera_lidar, pair.scan);
  if (pair.right_image && depth && !is_good(seen)) {
    FramePair exchanged{.image = *pair.right_image, .right_image = pair.image, .scan = pair.scan};
    if (const auto swapped = estimate(exchanged)) seen.swapped = trial(*swapped, seen, T_camera_lidar, pair.scan);
  }
  return depth ? std::optional(std::move(*depth)) : std::nullopt;
}

}  // namespace calib
