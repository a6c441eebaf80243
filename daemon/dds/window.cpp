#include "dds/window.hpp"

#include <algorithm>

#include "dds/messages.hpp"
#include "dds/names.hpp"

namespace calib {
namespace {

/// Takes the next sample, as `As`, or as `Malformed`.
template <typename As, typename Message, auto decode>
Result<std::optional<Sample>> take(dds_entity_t reader, const std::string& topic) {
  void* loan = nullptr;
  dds_sample_info_t info;
  const dds_return_t taken = dds_take(reader, &loan, &info, 1, 1);
  if (const auto took = check(taken, topic); !took) return tl::unexpected(took.error());
  std::optional<Sample> sample;
  if (taken == 1 && info.valid_data) {
    auto decoded = decode(*static_cast<const Message*>(loan));
    if (decoded)
      sample = As{std::move(*decoded)};
    else
      sample = Malformed{topic, std::move(decoded.error())};
  }
  if (taken > 0) dds_return_loan(reader, &loan, taken);
  return sample;
}

template <Colour colour>
Result<Image> image_of(const sensor_msgs_msg_dds__Image_& message) {
  return decode_image(message, colour);
}
template <Colour colour>
Result<Image> compressed_image_of(const sensor_msgs_msg_dds__CompressedImage_& message) {
  return decode_compressed_image(message, colour);
}

template <typename As, Colour colour = Colour::none>
constexpr auto take_image = take<As, sensor_msgs_msg_dds__Image_, image_of<colour>>;
template <typename As, Colour colour = Colour::none>
constexpr auto take_compressed = take<As, sensor_msgs_msg_dds__CompressedImage_, compressed_image_of<colour>>;
/// All of the fastest IMU's for as long as it takes to decode a large image.
constexpr int motion_history = 256;
constexpr auto take_cloud = take<DecodedCloud, sensor_msgs_msg_dds__PointCloud2_, decode_cloud>;
template <typename As>
constexpr auto take_camera_info = take<As, sensor_msgs_msg_dds__CameraInfo_, decode_camera_info>;
constexpr auto take_depth = take<DepthImage, sensor_msgs_msg_dds__Image_, decode_depth>;
constexpr auto take_imu = take<TurnRate, sensor_msgs_msg_dds__Imu_, decode_imu>;
constexpr auto take_odometry = take<TurnRate, nav_msgs_msg_dds__Odometry_, decode_odometry>;
constexpr auto take_disparity = take<DepthImage, stereo_msgs_msg_dds__DisparityImage_, decode_disparity>;

}  // namespace

Result<SamplingWindow> SamplingWindow::open(dds_entity_t participant, dds_entity_t interrupt,
                                            const PairTopics& topics) {
  SamplingWindow window;
  window.interrupt_ = interrupt;
  auto waitset = own(dds_create_waitset(participant), "waitset");
  if (!waitset) return tl::unexpected(waitset.error());
  window.waitset_ = std::move(*waitset);

  auto opened = check(dds_waitset_attach(window.waitset_.get(), interrupt, 0), "waitset");
  const auto add_image = [&](const std::string& topic, Take raw, Take compressed) {
    return is_compressed_topic(topic) ? window.add(participant, compressed_image_type, topic, compressed)
                                      : window.add(participant, image_type, topic, raw);
  };
  if (opened && topics.motion)  // first: a pair needs what was before it
    opened = topics.motion->message == MotionMessage::imu
                 ? window.add(participant, imu_type, topics.motion->name, take_imu, motion_history)
                 : window.add(participant, odometry_type, topics.motion->name, take_odometry, motion_history);
  if (opened && topics.colour == Colour::rgb)
    opened = add_image(topics.image, take_image<LeftImage, Colour::rgb>, take_compressed<LeftImage, Colour::rgb>);
  else if (opened)
    opened = add_image(topics.image, take_image<LeftImage>, take_compressed<LeftImage>);
  if (opened && topics.right_image)
    opened = add_image(*topics.right_image, take_image<RightImage>, take_compressed<RightImage>);
  if (opened) opened = window.add(participant, cloud_type, topics.cloud, take_cloud);
  if (opened && topics.camera_info)
    opened = window.add(participant, camera_info_type, *topics.camera_info, take_camera_info<CameraInfo>);
  if (opened && topics.right_camera_info)
    opened = window.add(participant, camera_info_type, *topics.right_camera_info, take_camera_info<RightCameraInfo>);
  if (opened && topics.depth)
    opened = topics.depth->message == DepthMessage::image
                 ? window.add(participant, image_type, topics.depth->name, take_depth)
                 : window.add(participant, disparity_image_type, topics.depth->name, take_disparity);
  if (!opened) return tl::unexpected(opened.error());
  return window;
}

Result<void> SamplingWindow::add(dds_entity_t participant, const MessageType& type, const std::string& topic, Take take,
                                 int history) {
  // Best effort matches reliable and best-effort writers, and a slow reader holds no writer back.
  auto endpoint = make_reader(participant, type, topic, {.reliable = false, .durable = false, .depth = history});
  if (!endpoint) return tl::unexpected(endpoint.error());
  auto new_sample = own(dds_create_readcondition(endpoint->endpoint.get(), DDS_ANY_STATE), topic);
  if (!new_sample) return tl::unexpected(new_sample.error());
  if (auto attached = check(dds_waitset_attach(waitset_.get(), new_sample->get(), 0), topic); !attached)
    return attached;
  readers_.push_back({topic, std::move(*endpoint), std::move(*new_sample), take, history});
  return {};
}

Result<std::vector<Sample>> SamplingWindow::wait(std::chrono::nanoseconds timeout) {
  const dds_duration_t patience = std::max<dds_duration_t>(timeout.count(), 0);
  if (const auto waited = check(dds_waitset_wait(waitset_.get(), nullptr, 0, patience), "waitset"); !waited)
    return tl::unexpected(waited.error());
  bool interrupted = false;
  if (const auto asked = check(dds_take_guardcondition(interrupt_, &interrupted), "guard condition"); !asked)
    return tl::unexpected(asked.error());

  std::vector<Sample> samples;
  if (interrupted) return samples;
  for (const Reader& reader : readers_)
    for (int i = 0; i < reader.history; ++i) {
      auto sample = reader.take(reader.endpoint.endpoint.get(), reader.topic);
      if (!sample) return tl::unexpected(sample.error());
      if (!*sample) break;
      samples.push_back(std::move(**sample));
    }
  return samples;
}

}  // namespace calib
