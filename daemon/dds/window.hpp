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
/// A message that was received and is not usable; `topic` as configured, `error.code` is one of
/// `malformed:*`.
struct Malformed {
  std::string topic;
  Error error;
};
using Sample =
    std::variant<LeftImage, RightImage, DecodedCloud, CameraInfo, RightCameraInfo, DepthImage, TurnRate, Malformed>;

/// Readers of a pair's topics, for as long as this lives: nothing else of calibd makes a sensor's data
/// travel. Must not outlive the `Bus` that opened it.
class SamplingWindow {
 public:
  /// `interrupt` is a guard condition of `participant`. Fails with `bad_topic` or `dds_failed`.
  [[nodiscard]] static Result<SamplingWindow> open(dds_entity_t participant, dds_entity_t interrupt,
                                                   const PairTopics& topics);

  /// Blocks until a sample arrives, the bus is interrupted, or `timeout` is over; returns the newest sample
  /// of each topic that has a new one (so at most one per topic, and the latest 256 of the topic of motion; none after
  /// a time-out or an interrupt).
  [[nodiscard]] Result<std::vector<Sample>> wait(std::chrono::nanoseconds timeout);

 private:
  SamplingWindow() = default;
  using Take = Result<std::optional<Sample>> (*)(dds_entity_t reader, const std::string& topic);
  struct Reader {
    std::string topic;
    Endpoint endpoint;
    Entity new_sample;  // read condition
    Take take;
    int history;
  };
  [[nodiscard]] Result<void> add(dds_entity_t participant, const MessageType& type, const std::string& topic, Take take,
                                 int history = 1);

  dds_entity_t interrupt_ = 0;
  std::vector<Reader> readers_;
  Entity waitset_;
};

}  // namespace calib
