#include "topic_probe.hpp"

#include <fmt/format.h>

#include <algorithm>

#include "dds/messages.hpp"

namespace calib {
namespace {

std::string type_name(const MessageType& type) { return ros_type_name(type.descriptor->m_typename); }

std::string image_type_name(const std::string& topic) {
  return type_name(is_compressed_topic(topic) ? compressed_image_type : image_type);
}

}  // namespace

std::vector<TopicObservation> topics_to_probe(const PairTopics& topics, bool camera_info_is_configured) {
  std::vector<TopicObservation> probed;
  const auto add = [&](const char* check, const char* key, const std::string& topic, const std::string& type) {
    probed.push_back({.check = check, .key = key, .topic = topic, .type = type});
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
  add("camera_info", "camera.info",
      topics.camera_info ? topics.camera_info->name : conventional_camera_info(topics.image),
      type_name(camera_info_type));
  probed.back().configured = camera_info_is_configured;
  return probed;
}

std::string conventional_camera_info(std::string image_topic) {
  if (is_compressed_topic(image_topic)) image_topic.erase(image_topic.rfind('/'));
  return image_topic.substr(0, image_topic.rfind('/') + 1) + "camera_info";
}

void TopicProbe::add(Sample sample, WallTime arrival) {
  std::visit([&](auto& each) { note(each, arrival); }, sample);
  while (auto pair = buffer_.take()) pair_ = std::move(*pair);
}

bool TopicProbe::has_enough(std::chrono::nanoseconds listened) const {
  const auto is_sampled = [&](const TopicObservation& topic) {
    const bool published = std::ranges::any_of(seen_.writers, [&](const RemoteWriter& writer) {
      return writer.topic == topic.topic && writer.type == topic.type && writer.obstacle.empty();
    });
    return !published || topic.messages >= enough_messages || !topic.malformed.empty();
  };
  return listened > (pair_ ? shortest : shortest_without_pair) && std::ranges::all_of(seen_.topics, is_sampled);
}

std::optional<FramePair> TopicProbe::take_pair() {
  if (pair_)
    seen_.time_difference = pair_->time_difference();
  else
    seen_.time_difference = tl::unexpected(buffer_.why_none());
  return std::move(pair_);
}

void TopicProbe::note(LeftImage& left, WallTime arrival) {
  count("image", left.image.stamp, arrival, left.image.notes);
  seen_.image = ImageSize{left.image.width, left.image.height};
  buffer_.add_image(std::move(left.image));
}

void TopicProbe::note(RightImage& right, WallTime arrival) {
  count("right_image", right.image.stamp, arrival, right.image.notes);
  buffer_.add_right_image(std::move(right.image));
}

void TopicProbe::note(DecodedCloud& cloud, WallTime arrival) {
  count("cloud", cloud.stamp, arrival, cloud.notes);
  seen_.cloud = cloud.statistics;
  seen_.has_reflectance = cloud.has_reflectance;
  buffer_.add_scan(std::move(cloud));
}

void TopicProbe::note(DepthImage& depth, WallTime arrival) {
  count("depth_topic", depth.stamp, arrival, depth.notes);
  buffer_.add_depth(std::move(depth));
}

void TopicProbe::note(TurnRate& rate, WallTime arrival) { count("motion_topic", rate.stamp, arrival, {}); }

void TopicProbe::note(CameraInfo& info, WallTime arrival) {
  count("camera_info", info.stamp, arrival, info.notes);
  seen_.camera_info = std::move(info);
}

void TopicProbe::note(RightCameraInfo& right, WallTime arrival) {
  count("right_camera_info", right.info.stamp, arrival, right.info.notes);
  right_camera_info_ = std::move(right.info);
}

void TopicProbe::note(Malformed& malformed, WallTime arrival) {
  const auto topic = std::ranges::find(seen_.topics, malformed.topic, &TopicObservation::topic);
  if (topic == seen_.topics.end()) return;
  if (malformed.image) {  // of another size and therefore not decoded; its header is valid
    count(topic->check, malformed.image->stamp, arrival, {});
    if (topic->check == "image")
      seen_.image = malformed.image->size;
    else
      seen_.companion_mismatch = fmt::format("{}: {}", malformed.topic, malformed.error.context);
    return;
  }
  ++topic->malformed[std::string(to_string(malformed.error.code))];
  topic->malformed_context = malformed.error.context;
}

void TopicProbe::count(std::string_view check, Timestamp stamp, WallTime arrival, const MessageNotes& notes) {
  const auto topic = std::ranges::find(seen_.topics, check, &TopicObservation::check);
  if (topic == seen_.topics.end()) return;
  ++topic->messages;
  if (topic->last_stamp == stamp) ++topic->repeated_stamps;
  topic->last_stamp = stamp;
  if (!notes.frame_id.empty()) topic->frame_id = notes.frame_id;
  for (const Error& remark : notes.remarks)
    topic->remarks.insert_or_assign(std::string(to_string(remark.code)), remark);
  const auto age = arrival - stamp;
  if (!topic->age || std::chrono::abs(age) < std::chrono::abs(*topic->age)) topic->age = age;
}

}  // namespace calib
