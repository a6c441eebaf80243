#pragma once

#include <chrono>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <variant>
#include <vector>

#include "dds/decode.hpp"
#include "dds/entity.hpp"
#include "dds/names.hpp"

namespace calib {

/// The ROS topics of a camera-LiDAR pair. Those that end in `/compressed` are read as CompressedImage.
struct PairTopics {
  std::string image;
  std::optional<std::string> right_image = {};
  std::string cloud;
  /// How its binning and roi are read holds for that of the right camera, too.
  std::optional<CameraInfoTopic> camera_info = {};
  std::optional<std::string> right_camera_info = {};
  std::optional<DepthTopic> depth = {};
  std::optional<MotionTopic> motion = {};
  Colour colour = Colour::none;  // of `image`
  /// Images of other sizes are not decoded.
  ImageBound image_bound = {}, right_bound = {}, depth_bound = {};
  std::uint64_t max_points = max_cloud_points;
};

struct LeftImage {
  Image image;
};
struct RightImage {
  Image image;
};
struct RightCameraInfo {
  CameraInfo info;
};
/// Stamp and size of an image that was not decoded, from its header.
struct UndecodedImage {
  Timestamp stamp{};
  ImageSize size;
};
/// A message that cannot be used. `topic` is as configured; `error.code` is `malformed:*`, `image_size_mismatch` (then
/// `image` is set) or `out_of_memory`.
struct Malformed {
  std::string topic;
  Error error;
  std::optional<UndecodedImage> image = {};
};
using Sample =
    std::variant<LeftImage, RightImage, DecodedCloud, CameraInfo, RightCameraInfo, DepthImage, TurnRate, Malformed>;

/// The readers of a pair's topics. Sensors send their data to calibd only while a window exists. A window must not
/// outlive the `Bus` that opened it. It may be opened, read and destroyed by different threads, one at a time.
///
/// Readers are best effort: they match all writers and never slow one down. There is one exception. Of a reliable
/// writer, Cyclone 0.10 keeps samples of which fragments were lost, at most `DefragReliableMaxSamples`, and while it is
/// at that limit it drops newer ones. A reliable reader would have the lost fragments sent again; with best-effort
/// readers alone nothing ends this, and the topic stays silent for ever. So after three windows in a row in which a
/// matched writer was not heard, the next one reads that topic reliably, if all its writers are reliable. The first
/// heartbeat, which a reliable reader is always sent, discards the incomplete samples. Fewer windows would have writers
/// that are only slower than a window wait for calibd's acknowledgements.
class SamplingWindow {
 public:
  /// Topics of which the last windows heard nothing although there was a writer, and how many these were.
  using Topics = std::map<std::string, int>;

  /// `interrupt` is a guard condition of `participant`. Windows keep `silent` and share it. Fails with `bad_topic` or
  /// `dds_failed`.
  [[nodiscard]] static Result<SamplingWindow> open(dds_entity_t participant, dds_entity_t interrupt,
                                                   const PairTopics& topics, std::shared_ptr<Topics> silent);

  /// Waits until a sample arrives, the bus is interrupted, or `timeout` has passed. Returns the newest sample of each
  /// topic that has a new one, and of the motion topic the newest 256; none after a timeout or an interrupt. Decodes
  /// them, which takes at most as long as decode.hpp says. A message that cannot be decoded becomes `Malformed`; none
  /// makes this fail or throw.
  [[nodiscard]] Result<std::vector<Sample>> wait(std::chrono::nanoseconds timeout);

 private:
  SamplingWindow() = default;
  struct Limits {
    ImageBound image = {};
    std::uint64_t max_points = 0;
    InfoReduction reduction = InfoReduction::as_specified;
  };
  template <typename As, typename Message, auto decode>
  static Result<std::optional<Sample>> take_next(dds_entity_t reader, const std::string& topic, const Limits& limits);
  using Take = Result<std::optional<Sample>> (*)(dds_entity_t reader, const std::string& topic, const Limits& limits);
  struct Reader {
    std::string topic;
    Endpoint endpoint;
    Entity new_sample;  // read condition
    Take take;
    Limits limits;
    int history;
    bool heard = false;
  };
  [[nodiscard]] Result<void> add(dds_entity_t participant, const MessageType& type, const std::string& topic, Take take,
                                 Limits limits, int history = 1);
  template <typename As, Colour colour>
  [[nodiscard]] Result<void> add_image(dds_entity_t participant, const std::string& topic, const ImageBound& bound);
  [[nodiscard]] Result<void> add_all(dds_entity_t participant, const PairTopics& topics);
  void note_silence();

  dds_entity_t interrupt_ = 0;
  std::vector<Reader> readers_;
  Entity waitset_;
  std::shared_ptr<Topics> silent_;
  Topics silent_before_;  // this window
  std::set<std::string> read_reliably_;
};

}  // namespace calib
