#include "diagnosis.hpp"

#include <fmt/format.h>

#include <cmath>

#include "calib/overlay.hpp"
#include "calib/wall_time.hpp"
#include "topic_probe.hpp"

namespace calib {
namespace {

using std::chrono::steady_clock;

constexpr std::chrono::milliseconds longest_listening{5000};
/// With depth this good, exchanged stereo images need not be tried: they too match in some places by chance.
constexpr double good_agreement = 0.7, good_share = 0.3;

/// Written under another name first, so that nobody reads half a picture.
Result<void> draw(const std::filesystem::path& file, const FramePair& pair, const RigidTransform& T_camera_lidar,
                  const Camera& camera, const DepthMap* depth, const OverlayCaption& caption) {
  std::error_code error;
  std::filesystem::create_directories(file.parent_path(), error);
  auto unfinished = file;
  unfinished.replace_extension(".new.png");
  if (auto written = write_overlay(unfinished, pair, camera, T_camera_lidar, depth, &caption); !written) return written;
  std::filesystem::rename(unfinished, file, error);
  if (error) return fail(ErrorCode::write_failed, file.string() + " cannot be written: " + error.message());
  return {};
}

/// "image /left/image, 2026-01-31T12:00:00.000Z, 40 ms old". A stamp need not be of this computer's clock.
std::string frame_words(std::string_view what, const std::string& topic, Timestamp stamp, WallTime now) {
  const auto age = std::chrono::abs(now - stamp);
  const auto words = age < std::chrono::seconds(1)
                         ? fmt::format("{} ms", std::chrono::duration_cast<std::chrono::milliseconds>(age).count())
                         : duration_words(age);
  return fmt::format("{} {}, {}, {} {}", what, topic, rfc3339(stamp), words, now < stamp ? "ahead" : "old");
}

/// The codes of what was found, problems first.
std::string found_words(const std::vector<Finding>& findings) {
  std::string words;
  for (const FindingResult result : {FindingResult::problem, FindingResult::warning})
    for (const Finding& finding : findings)
      if (finding.result == result)
        words += fmt::format("{}{} {} ({})", words.empty() ? "" : ", ", to_string(result), finding.code, finding.check);
  return words.empty() ? "no problem found" : words;
}

OverlayCaption caption_of(const DiagnosisInput& input, const PairObservation& seen, const FramePair& pair,
                          const std::vector<Finding>& findings, WallTime now) {
  OverlayCaption caption{.title = input.pair.name + (input.verdict.empty() ? "" : ": " + input.verdict)};
  const auto& agreement = seen.extrinsic ? seen.extrinsic->agreement : std::nullopt;
  if (agreement)
    caption.title += fmt::format("; rank correlation of depth and cloud {:.2f}", agreement->rank_correlation);
  caption.lines = {frame_words("image", input.topics.image, pair.image.stamp, now),
                   frame_words("cloud", input.topics.cloud, pair.scan.stamp, now) +
                       fmt::format(", {:.0f} ms apart",
                                   std::abs(std::chrono::duration<double, std::milli>(pair.time_difference()).count())),
                   found_words(findings)};
  return caption;
}

/// The camera that CameraInfo describes, if it is for images of the configured size.
std::optional<Camera> camera_of_info(const PairObservation& seen) {
  if (!seen.camera_info) return std::nullopt;
  const CameraInfo& info = *seen.camera_info;
  auto camera = Camera::make(info.model, info.width, info.height, {info.K[0], info.K[4], info.K[2], info.K[5]}, info.D);
  const bool same_size = info.width == seen.camera.width() && info.height == seen.camera.height();
  return camera && same_size ? std::optional(std::move(*camera)) : std::nullopt;
}

DepthTrial trial(const DepthMap& depth, const PairObservation& seen, const RigidTransform& T_camera_lidar,
                 const LidarScan& scan) {
  return {depth.valid_share(), depth_agreement(depth, seen.camera, T_camera_lidar, scan)};
}

bool is_good(const PairObservation& seen) {
  const auto& agreement = seen.extrinsic ? seen.extrinsic->agreement : std::nullopt;
  return seen.depth && seen.depth->valid_share >= good_share && agreement &&
         agreement->rank_correlation > good_agreement;
}

/// Listens to the topics of the pair and to the CameraInfo that belongs to its image. Returns the last pair of samples,
/// or nothing if there is none. Fails with `dds_failed` or `bad_topic`.
Result<std::optional<FramePair>> listen(const DiagnosisInput& input, Network& network, DepthSource& depth,
                                        const std::function<bool()>& keep_going, PairObservation& seen) {
  const bool camera_info_is_configured = input.pair.camera.info.has_value();
  seen.topics = topics_to_probe(input.topics, camera_info_is_configured);
  seen.topics_in_use = input.image_topics_in_use;
  for (const TopicObservation& topic : seen.topics) seen.topics_in_use.insert(topic.topic);
  PairTopics topics = input.topics;
  if (!topics.camera_info) topics.camera_info = CameraInfoTopic{.name = conventional_camera_info(topics.image)};
  auto window = network.open_window(topics);
  if (!window) return propagate(window);
  const Companions companions{.right_image = topics.right_image.has_value(), .depth = topics.depth.has_value()};
  TopicProbe probe(seen, PairBuffer(input.sampling.max_time_difference, companions));
  const auto start = steady_clock::now();
  while (keep_going() && steady_clock::now() < start + longest_listening) {
    auto samples = (*window)->wait(std::chrono::milliseconds(200));
    if (!samples) return propagate(samples);
    for (Sample& sample : *samples) probe.add(std::move(sample), std::chrono::system_clock::now().time_since_epoch());
    seen.listened = steady_clock::now() - start;
    if (seen.listened < TopicProbe::shortest) continue;
    auto writers = network.remote_writers();
    if (!writers) return propagate(writers);
    seen.writers = std::move(*writers);
    if (probe.has_enough(seen.listened)) break;
  }
  if (camera_info_is_configured && seen.camera_info) depth.set_left_camera_info(*seen.camera_info);
  if (probe.right_camera_info()) depth.set_right_camera_info(*probe.right_camera_info());
  return probe.take_pair();
}

/// Estimates depth as for an evaluation, and compares it with the cloud at the extrinsic in force: with the configured
/// lens, with that of CameraInfo, and, if the agreement is poor, with the stereo images exchanged.
std::optional<DepthMap> try_depth(const DiagnosisInput& input, const FramePair& pair, DepthSource& source,
                                  const std::function<bool()>& keep_going, PairObservation& seen) {
  const auto estimate = [&](const FramePair& of) -> Result<DepthMap> {
    auto depth = source.estimate(of);
    if (!depth) return depth;
    if (const auto masked = mask_depth(of.image, input.pair.depth_range, *depth); !masked) return propagate(masked);
    return depth;
  };
  const auto scene = check_pair(pair, seen.camera, nullptr, {});
  if (!scene && scene.error().code != ErrorCode::image_size_mismatch) seen.scene = scene.error();
  if (seen.image != size_of(seen.camera)) return std::nullopt;
  auto depth = estimate(pair);
  if (depth)
    seen.depth = trial(*depth, seen, input.T_camera_lidar, pair.scan);
  else if (seen.depth || seen.depth.error().code == ErrorCode::no_pair)
    seen.depth = propagate(depth);
  seen.extrinsic = examine_extrinsic(seen.camera, input.T_camera_lidar, pair.scan, depth ? &*depth : nullptr);
  if (!depth) return std::nullopt;
  [[maybe_unused]] const bool on = keep_going();  // feeds the watchdog
  if (const auto camera = camera_of_info(seen))
    seen.info_agreement = depth_agreement(*depth, *camera, input.T_camera_lidar, pair.scan);
  if (pair.right_image && !is_good(seen)) {
    FramePair exchanged{.image = *pair.right_image, .right_image = pair.image, .scan = pair.scan};
    if (const auto swapped = estimate(exchanged)) seen.swapped = trial(*swapped, seen, input.T_camera_lidar, pair.scan);
  }
  return std::move(*depth);
}

}  // namespace

void diagnose_pair(const DiagnosisInput& input, Network& network, DepthSource& depth,
                   const std::function<bool()>& keep_going, DiagnosisReport& report) {
  const std::string& name = input.pair.name;
  PairObservation seen{.camera = input.pair.camera.camera, .depth_kind = depth_kind(input.pair.depth)};
  seen.pair = name;
  seen.camera_frame = input.pair.camera.frame_id;
  seen.lidar_frame = input.pair.lidar.frame_id;
  seen.domain = input.dds.domain;
  seen.interface = input.dds.interface;
  seen.min_valid_depth = QualityLimits{}.min_valid_depth;
  const auto pair = listen(input, network, depth, keep_going, seen);
  if (!pair) seen.time_difference = propagate(pair);
  if (const auto ready = depth.prepare(); !ready && seen.depth_kind.preparation_failure)
    seen.depth = fail(seen.depth_kind.preparation_failure->code, ready.error().context);
  const WallTime arrived = std::chrono::system_clock::now().time_since_epoch();
  std::optional<DepthMap> map;
  if (pair && *pair) map = try_depth(input, **pair, depth, keep_going, seen);
  const std::vector<Finding> findings = diagnose(seen);
  for (const Finding& finding : findings) report.checks.push_back({name, finding});
  if (!pair || !*pair) return;
  const auto file = input.picture_folder / (name + ".png");
  const auto drawn = draw(file, **pair, input.T_camera_lidar, seen.camera, map ? &*map : nullptr,
                          caption_of(input, seen, **pair, findings, arrived));
  if (drawn)
    report.overlays.push_back({name, file});
  else
    report.checks.push_back(
        {name,
         {"picture", FindingResult::warning, std::string(to_string(drawn.error().code)), drawn.error().context,
          "state_dir is full or not writable", "make room, or correct state_dir"}});
}

}  // namespace calib
