#include "dds/window.hpp"

#include <algorithm>

#include "dds/compressed_probe.hpp"
#include "dds/discovery.hpp"
#include "dds/messages.hpp"
#include "dds/names.hpp"
#include "dds/no_throw.hpp"

namespace calib {
namespace {

/// Holds all samples of a fast IMU that arrive while a large image is decoded.
constexpr int motion_history = 256;

UndecodedImage seen(const sensor_msgs_msg_dds__Image_& message) {
  return {decode_stamp(message.header).value_or(Timestamp{}),
          {static_cast<int>(message.width), static_cast<int>(message.height)}};
}
UndecodedImage seen(const stereo_msgs_msg_dds__DisparityImage_& message) { return seen(message.image); }
UndecodedImage seen(const sensor_msgs_msg_dds__CompressedImage_& message) {
  const auto header = probe_compressed({message.data._buffer, message.data._length});
  return {decode_stamp(message.header).value_or(Timestamp{}), header ? header->size : ImageSize{}};
}

/// Those that were silent for some windows and whose writers are all reliable. There is no way to ask for what a
/// best-effort writer lost.
Result<std::set<std::string>> to_read_reliably(dds_entity_t participant, const SamplingWindow::Topics& silent) {
  constexpr int enough_windows = 3;
  std::set<std::string> topics;
  for (const auto& [topic, windows] : silent)
    if (windows >= enough_windows) topics.insert(topic);
  if (topics.empty()) return topics;
  const auto writers = remote_writers(participant);
  if (!writers) return propagate(writers);
  for (const RemoteWriter& writer : *writers)
    if (!writer.reliable) topics.erase(writer.topic);
  return topics;
}

}  // namespace

/// The next sample, as `As` or as `Malformed`.
template <typename As, typename Message, auto decode>
Result<std::optional<Sample>> SamplingWindow::take_next(dds_entity_t reader, const std::string& topic,
                                                        const Limits& limits) {
  void* loan = nullptr;
  dds_sample_info_t info;
  const dds_return_t taken = dds_take(reader, &loan, &info, 1, 1);
  if (const auto took = check(taken, topic); !took) return propagate(took);
  std::optional<Sample> sample;
  if (taken == 1 && info.valid_data) {
    const auto& message = *static_cast<const Message*>(loan);
    auto decoded = no_throw([&] { return decode(message, limits); });
    if (decoded) {
      sample = As{std::move(*decoded)};
    } else {
      Malformed malformed{topic, std::move(decoded.error())};
      if constexpr (requires { seen(message); })
        if (malformed.error.code == ErrorCode::image_size_mismatch) malformed.image = seen(message);
      sample = std::move(malformed);
    }
  }
  if (taken > 0) dds_return_loan(reader, &loan, taken);
  return sample;
}

template <typename As, Colour colour>
Result<void> SamplingWindow::add_image(dds_entity_t participant, const std::string& topic, const ImageBound& bound) {
  constexpr auto raw = [](const auto& message, const Limits& limits) {
    return decode_image(message, colour, limits.image);
  };
  constexpr auto compressed = [](const auto& message, const Limits& limits) {
    return decode_compressed_image(message, colour, limits.image);
  };
  return is_compressed_topic(topic)
             ? add(participant, compressed_image_type, topic,
                   take_next<As, sensor_msgs_msg_dds__CompressedImage_, compressed>, {.image = bound})
             : add(participant, image_type, topic, take_next<As, sensor_msgs_msg_dds__Image_, raw>, {.image = bound});
}

Result<SamplingWindow> SamplingWindow::open(dds_entity_t participant, dds_entity_t interrupt, const PairTopics& topics,
                                            std::shared_ptr<Topics> silent) {
  SamplingWindow window;
  window.interrupt_ = interrupt;
  window.silent_ = std::move(silent);
  window.silent_before_ = *window.silent_;
  auto read_reliably = to_read_reliably(participant, window.silent_before_);
  if (!read_reliably) return propagate(read_reliably);
  window.read_reliably_ = std::move(*read_reliably);
  auto waitset = own(dds_create_waitset(participant), "waitset");
  if (!waitset) return propagate(waitset);
  window.waitset_ = std::move(*waitset);
  auto opened = check(dds_waitset_attach(window.waitset_.get(), interrupt, 0), "waitset");
  if (opened) opened = window.add_all(participant, topics);
  if (!opened) return propagate(opened);
  return window;
}

Result<void> SamplingWindow::add_all(dds_entity_t participant, const PairTopics& topics) {
  constexpr auto cloud = [](const auto& message, const Limits& limits) {
    return decode_cloud(message, limits.max_points);
  };
  constexpr auto info = [](const auto& message, const Limits& limits) {
    return decode_camera_info(message, limits.reduction);
  };
  constexpr auto depth = [](const auto& message, const Limits& limits) { return decode_depth(message, limits.image); };
  constexpr auto disparity = [](const auto& message, const Limits& limits) {
    return decode_disparity(message, limits.image);
  };
  constexpr auto imu = [](const auto& message, const Limits&) { return decode_imu(message); };
  constexpr auto odometry = [](const auto& message, const Limits&) { return decode_odometry(message); };
  using Info = sensor_msgs_msg_dds__CameraInfo_;

  Result<void> added;
  if (topics.motion)  // first: a pair needs the turn rates from before it
    added = topics.motion->message == MotionMessage::imu
                ? add(participant, imu_type, topics.motion->name, take_next<TurnRate, sensor_msgs_msg_dds__Imu_, imu>,
                      {}, motion_history)
                : add(participant, odometry_type, topics.motion->name,
                      take_next<TurnRate, nav_msgs_msg_dds__Odometry_, odometry>, {}, motion_history);
  if (added)
    added = topics.colour == Colour::rgb
                ? add_image<LeftImage, Colour::rgb>(participant, topics.image, topics.image_bound)
                : add_image<LeftImage, Colour::none>(participant, topics.image, topics.image_bound);
  if (added && topics.right_image)
    added = add_image<RightImage, Colour::none>(participant, *topics.right_image, topics.right_bound);
  if (added)
    added = add(participant, cloud_type, topics.cloud,
                take_next<DecodedCloud, sensor_msgs_msg_dds__PointCloud2_, cloud>, {.max_points = topics.max_points});
  const Limits of_info{.reduction = topics.camera_info.value_or(CameraInfoTopic()).reduction};
  if (added && topics.camera_info)
    added = add(participant, camera_info_type, topics.camera_info->name, take_next<CameraInfo, Info, info>, of_info);
  if (added && topics.right_camera_info)
    added =
        add(participant, camera_info_type, *topics.right_camera_info, take_next<RightCameraInfo, Info, info>, of_info);
  if (added && topics.depth)
    added = topics.depth->message == DepthMessage::image
                ? add(participant, image_type, topics.depth->name,
                      take_next<DepthImage, sensor_msgs_msg_dds__Image_, depth>, {.image = topics.depth_bound})
                : add(participant, disparity_image_type, topics.depth->name,
                      take_next<DepthImage, stereo_msgs_msg_dds__DisparityImage_, disparity>,
                      {.image = topics.depth_bound});
  return added;
}

Result<void> SamplingWindow::add(dds_entity_t participant, const MessageType& type, const std::string& topic, Take take,
                                 Limits limits, int history) {
  auto endpoint = make_reader(participant, type, topic,
                              {.reliable = read_reliably_.contains(topic), .durable = false, .depth = history});
  if (!endpoint) return propagate(endpoint);
  auto new_sample = own(dds_create_readcondition(endpoint->endpoint.get(), DDS_ANY_STATE), topic);
  if (!new_sample) return propagate(new_sample);
  if (auto attached = check(dds_waitset_attach(waitset_.get(), new_sample->get(), 0), topic); !attached)
    return attached;
  readers_.push_back({.topic = topic,
                      .endpoint = std::move(*endpoint),
                      .new_sample = std::move(*new_sample),
                      .take = take,
                      .limits = std::move(limits),
                      .history = history});
  return {};
}

Result<std::vector<Sample>> SamplingWindow::wait(std::chrono::nanoseconds timeout) {
  const dds_duration_t patience = std::max<dds_duration_t>(timeout.count(), 0);
  if (const auto waited = check(dds_waitset_wait(waitset_.get(), nullptr, 0, patience), "waitset"); !waited)
    return propagate(waited);
  bool interrupted = false;
  if (const auto asked = check(dds_take_guardcondition(interrupt_, &interrupted), "guard condition"); !asked)
    return propagate(asked);

  std::vector<Sample> samples;
  if (interrupted) return samples;
  for (Reader& reader : readers_)
    for (int i = 0; i < reader.history; ++i) {
      auto sample = reader.take(reader.endpoint.endpoint.get(), reader.topic, reader.limits);
      if (!sample) return propagate(sample);
      if (!*sample) break;
      reader.heard = true;
      samples.push_back(std::move(**sample));
    }
  note_silence();
  return samples;
}

/// So far: the next wait may hear of a topic after all.
void SamplingWindow::note_silence() {
  for (const Reader& reader : readers_)
    if (!reader.heard && dds_get_matched_publications(reader.endpoint.endpoint.get(), nullptr, 0) > 0) {
      const auto before = silent_before_.find(reader.topic);
      (*silent_)[reader.topic] = before == silent_before_.end() ? 1 : before->second + 1;
    } else {
      silent_->erase(reader.topic);
    }
}

}  // namespace calib
