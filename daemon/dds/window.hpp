#pragma once

#include <chrono>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "dds/decode.hpp"
#include "dds/entity.hpp"
#include "dds/names.hpp"

namespace calib {

/// The ROS topics of a camera-LiDAR pair. One that ends in `/compressed` is read as CompressedImage.
struct PairTopics {
  std::string image;
  std::optional<std::string> right_image = {};
  std::string cloud;
  std::optional<std::string> camera_info = {};
  std::optional<std::string> right_camera_info = {};
  std::optional<DepthTopic> depth = {};
  std::optional<MotionTopic> motion = {};
  /// Of `image`.
  Colour colour = Colour::none;
  /// What is larger, or another size, is refused by its header.
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
/// What an image that was not decoded says of itself.
struct SeenImage {
  Timestamp stamp{};
  ImageSize size;
};
/// A message that was received and is not usable; `topic` as configured, `error.code` is one of `malformed:*`,
/// `image_size_mismatch` (then with what the image says of itself) and `out_of_memory`: a closed set.
struct Malformed {
  std::string topic;
  Error error;
  std::optional<SeenImage> image = {};
};
using Sample =
    std::variant<LeftImage, RightImage, DecodedCloud, CameraInfo, RightCameraInfo, DepthImage, TurnRate, Malformed>;

/// Readers of a pair's topics, for as long as this lives: nothing else of calibd makes a sensor's data
/// travel. Must not outlive the `Bus` that opened it. Used by one thread at a time, which need not be the one that
/// opened it nor the one that ends it: `wait` may run on another, as long as the window outlives the call.
class SamplingWindow {
 public:
  /// `interrupt` is a guard condition of `participant`. Fails with `bad_topic` or `dds_failed`.
  [[nodiscard]] static Result<SamplingWindow> open(dds_entity_t participant, dds_entity_t interrupt,
                                                   const PairTopics& topics);

  /// Blocks until a sample arrives, the bus is interrupted, or `timeout` is over; returns the newest sample
  /// of each topic that has a new one (so at most one per topic, and the latest 256 of the topic of motion; none after
  /// a time-out or an interrupt). Decodes them, which takes as long as decode.hpp's bounds let it. Nothing is thrown
  /// for what a message holds: it ends as `Malformed`.
  [[nodiscard]] Result<std::vector<Sample>> wait(std::chrono::nanoseconds timeout);

 private:
  SamplingWindow() = default;
  struct Limits {
    ImageBound image = {};
    std::uint64_t max_points = 0;
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
  };
  [[nodiscard]] Result<void> add(dds_entity_t participant, const MessageType& type, const std::string& topic, Take take,
                                 Limits limits, int history = 1);
  template <typename As, Colour colour>
  [[nodiscard]] Result<void> add_image(dds_entity_t participant, const std::string& topic, const ImageBound& bound);
  [[nodiscard]] Result<void> add_all(dds_entity_t participant, const PairTopics& topics);

  dds_entity_t interrupt_ = 0;
  std::vector<Reader> readers_;
  Entity waitset_;
};

}  // namespace calib
