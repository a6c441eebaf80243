#pragma once

#include <chrono>
#include <optional>
#include <string_view>
#include <vector>

#include "calib/pairing.hpp"
#include "calib/wall_time.hpp"
#include "dds/window.hpp"
#include "findings.hpp"

namespace calib {

/// The topics that a diagnosis listens to, in the order of its findings. The CameraInfo of the image is always among
/// them: on its conventional topic if `topics` has none, and marked as not configured unless
/// `camera_info_is_configured`.
[[nodiscard]] std::vector<TopicObservation> topics_to_probe(const PairTopics& topics, bool camera_info_is_configured);

/// The conventional topic of an image's CameraInfo: `/front/camera_info` for `/front/image` and
/// `/front/image/compressed`.
[[nodiscard]] std::string conventional_camera_info(std::string image_topic);

/// Records what arrives on the topics of a pair, and forms pairs of samples as sampling does.
class TopicProbe {
 public:
  /// Listening takes at least `shortest`, and without a pair at least `shortest_without_pair`.
  static constexpr std::chrono::milliseconds shortest{500}, shortest_without_pair{1500};
  /// Of one topic: enough to check its stamps.
  static constexpr std::uint64_t enough_messages = 5;

  /// Writes what arrives into `seen`, whose `topics` are those listened to. `seen` outlives the probe.
  TopicProbe(PairObservation& seen, PairBuffer buffer) : seen_(seen), buffer_(std::move(buffer)) {}

  void add(Sample sample, WallTime arrival);

  /// Whether listening for this long suffices: enough messages, or one that cannot be used, arrived on each topic for
  /// which `seen.writers` has a matching publisher.
  [[nodiscard]] bool has_enough(std::chrono::nanoseconds listened) const;

  /// Ends the probe: returns the latest pair, and sets `seen.time_difference` to that of the pair or to the reason why
  /// there is none.
  [[nodiscard]] std::optional<FramePair> take_pair();

  /// The last one that arrived.
  [[nodiscard]] const std::optional<CameraInfo>& right_camera_info() const { return right_camera_info_; }

 private:
  void note(LeftImage& left, WallTime arrival);
  void note(RightImage& right, WallTime arrival);
  void note(DecodedCloud& cloud, WallTime arrival);
  void note(DepthImage& depth, WallTime arrival);
  void note(TurnRate& rate, WallTime arrival);
  void note(CameraInfo& info, WallTime arrival);
  void note(RightCameraInfo& right, WallTime arrival);
  void note(Malformed& malformed, WallTime arrival);
  void count(std::string_view check, Timestamp stamp, WallTime arrival, const MessageNotes& notes);

  PairObservation& seen_;
  PairBuffer buffer_;
  std::optional<FramePair> pair_;
  std::optional<CameraInfo> right_camera_info_;
};

}  // namespace calib
