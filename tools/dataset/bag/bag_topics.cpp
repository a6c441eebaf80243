#include "dataset/bag/bag_topics.hpp"

#include <algorithm>
#include <functional>
#include <string_view>
#include <utility>

#include "dataset/bag/ros_message.hpp"

namespace calib {
namespace {

using Topics = std::vector<BagTopic>;
using Accepts = std::function<bool(const BagTopic&)>;

/// What the command line calls a topic, and what it carries.
struct Wanted {
  const char* option;
  const char* what;
  bool (*type)(const BagTopic&);
};

bool is_image(const BagTopic& topic) {
  return topic.is(bag_type::image) ||
         (topic.is(bag_type::compressed_image) && !topic.name.ends_with("/compressedDepth"));
}
bool is_depth(const BagTopic& topic) { return topic.is(bag_type::image) || topic.is(bag_type::disparity); }
bool is_cloud(const BagTopic& topic) { return topic.is(bag_type::cloud); }
bool is_info(const BagTopic& topic) { return topic.is(bag_type::camera_info); }

/// Without the name of a transport.
std::string base_name(const BagTopic& topic) {
  constexpr std::string_view transport = "/compressed";
  std::string name = topic.name;
  if (topic.is(bag_type::compressed_image) && name.ends_with(transport)) name.resize(name.size() - transport.size());
  return name;
}

/// Whether the images of a topic hold depth, by the first of them.
bool holds_depth(const Bag& bag, const BagTopic& topic) {
  if (topic.is(bag_type::disparity)) return true;
  if (!topic.is(bag_type::image)) return false;
  const auto messages = bag.messages(topic);
  if (messages.empty()) return false;
  const auto first =
      bag.read(messages.front()).and_then([](const Octets& bytes) { return RosMessage::read(bytes, image_type); });
  if (!first) return false;
  const char* const encoding = first->as<sensor_msgs_msg_dds__Image_>().encoding;
  const std::string_view name = encoding != nullptr ? encoding : "";
  return name == "16UC1" || name == "32FC1" || (name == "mono16" && topic.name.find("depth") != std::string::npos);
}

/// The name of the right camera's topic, by that of the left one's.
std::optional<std::string> right_of(const std::string& name) {
  constexpr std::pair<std::string_view, std::string_view> sides[] = {{"left", "right"}, {"infra1", "infra2"}};
  for (const auto& [left, right] : sides)
    if (const auto at = name.rfind(left); at != std::string::npos)
      return name.substr(0, at) + std::string(right) + name.substr(at + left.size());
  return std::nullopt;
}

const BagTopic* find(const Topics& topics, const std::string& name) {
  const auto found = std::ranges::find(topics, name, &BagTopic::name);
  return found == topics.end() ? nullptr : &*found;
}

/// Cameras to choose from: what is there as Image as well as compressed counts once, and so does a stereo camera.
Topics cameras(const Bag& bag, bool with_right_ones) {
  Topics images;
  for (const BagTopic& topic : bag.topics())
    if (topic.messages > 0 && is_image(topic) && !holds_depth(bag, topic)) images.push_back(topic);
  Topics chosen;
  for (const BagTopic& topic : images) {
    const bool is_twin = base_name(topic) != topic.name && find(images, base_name(topic)) != nullptr;
    const bool is_right = std::ranges::any_of(
        images, [&](const BagTopic& left) { return left.name != topic.name && right_of(left.name) == topic.name; });
    if (!is_twin && (with_right_ones || !is_right)) chosen.push_back(topic);
  }
  return chosen;
}

Topics candidates_of(const Bag& bag, const Accepts& accepts) {
  Topics candidates;
  for (const BagTopic& topic : bag.topics())
    if (topic.messages > 0 && accepts(topic)) candidates.push_back(topic);
  return candidates;
}

Result<BagTopic> choose(const Bag& bag, const std::string& given, const Wanted& wanted, const Topics& candidates) {
  const std::string how = std::string("choose one with ") + wanted.option;
  if (!given.empty()) {
    const std::string name = given.starts_with('/') ? given : '/' + given;
    const BagTopic* topic = find(bag.topics(), given);
    if (topic == nullptr) topic = find(bag.topics(), name);
    const std::string others =
        candidates.empty() ? "; it holds " + list_of(bag.topics()) : "; there are " + list_of(candidates);
    if (topic == nullptr) return fail(ErrorCode::bad_topic, "the recording has no topic " + given + others);
    if (!wanted.type(*topic))
      return fail(ErrorCode::bad_topic, list_of({*topic}) + " is no topic with " + wanted.what + others);
    if (topic->messages == 0) return fail(ErrorCode::bad_topic, "the topic " + given + " has no message" + others);
    return *topic;
  }
  if (candidates.size() == 1) return candidates.front();
  if (candidates.empty())
    return fail(ErrorCode::bad_topic,
                std::string("no topic of the recording has ") + wanted.what + "; it holds " + list_of(bag.topics()));
  return fail(ErrorCode::bad_topic, std::to_string(candidates.size()) + " topics of the recording have " + wanted.what +
                                        ": " + list_of(candidates) + "; " + how);
}

}  // namespace

std::string list_of(const Topics& topics) {
  constexpr std::size_t most = 20;
  std::string text;
  for (std::size_t i = 0; i < std::min(most, topics.size()); ++i) {
    const BagTopic& topic = topics[i];
    text += (i == 0 ? "" : ", ") + escape_control(topic.name) + " (" + escape_control(topic.type) +
            (topic.encoding == "cdr" ? "" : " as '" + escape_control(topic.encoding) + "', which is not of ROS 2") +
            ", " + std::to_string(topic.messages) + (topic.messages == 1 ? " message)" : " messages)");
  }
  if (topics.empty()) return "no topic";
  return topics.size() > most ? text + " and " + std::to_string(topics.size() - most) + " more" : text;
}

bool names_rectified_images(const std::string& topic) {
  std::size_t end = topic.size();
  for (int parts = 0; parts < 3 && end != std::string::npos && end > 0; ++parts) {
    const auto slash = topic.rfind('/', end - 1);
    const std::string part = topic.substr(slash + 1, end - slash - 1);
    if (part.starts_with("image_rect") || part.ends_with("_rect") || part.starts_with("rectif")) return true;
    end = slash;
  }
  return false;
}

std::optional<BagTopic> info_beside(const Bag& bag, const BagTopic& image) {
  const std::string base = base_name(image);
  const auto infos = candidates_of(bag, is_info);
  if (const BagTopic* beside = find(infos, base.substr(0, base.rfind('/') + 1) + "camera_info")) return *beside;
  if (const BagTopic* below = find(infos, base + "/camera_info")) return *below;
  if (infos.size() == 1) return infos.front();
  return std::nullopt;
}

Result<BagTopics> choose_topics(const Bag& bag, const BagOptions& options) {
  BagTopics topics;
  const auto image = choose(bag, options.image, {"--image-topic", "images", is_image}, cameras(bag, false));
  if (!image) return propagate(image);
  topics.image = *image;
  const auto cloud = choose(bag, options.cloud, {"--cloud-topic", "clouds", is_cloud}, candidates_of(bag, is_cloud));
  if (!cloud) return propagate(cloud);
  topics.cloud = *cloud;

  const auto info_of = [&](const std::string& given, const char* option,
                           const BagTopic& of) -> Result<std::optional<BagTopic>> {
    if (given.empty()) return info_beside(bag, of);
    const auto info = choose(bag, given, {option, "CameraInfo", is_info}, candidates_of(bag, is_info));
    if (!info) return propagate(info);
    return *info;
  };
  const auto info = info_of(options.info, "--info-topic", topics.image);
  if (!info) return propagate(info);
  topics.info = *info;

  const auto counterpart = right_of(topics.image.name);
  const bool is_there = counterpart && find(cameras(bag, true), *counterpart) != nullptr;
  if (options.needs_right_image || !options.right_image.empty() || (options.takes_right_image && is_there)) {
    auto others = cameras(bag, true);
    std::erase_if(others, [&](const BagTopic& topic) { return base_name(topic) == base_name(topics.image); });
    if (is_there) others = {BagTopic(*find(others, *counterpart))};
    const auto right =
        choose(bag, options.right_image, {"--right-image-topic", "images of a right camera", is_image}, others);
    if (!right) return propagate(right);
    topics.right_image = *right;
    const auto right_info = info_of(options.right_info, "--right-info-topic", *right);
    if (!right_info) return propagate(right_info);
    topics.right_info = *right_info;
    if (options.right_info.empty() && topics.info && topics.right_info && topics.right_info->name == topics.info->name)
      topics.right_info.reset();  // the only one there is
  }
  if (options.needs_depth || !options.depth.empty()) {
    const auto depth = choose(bag, options.depth, {"--depth-topic", "depth", is_depth},
                              candidates_of(bag, [&](const BagTopic& topic) { return holds_depth(bag, topic); }));
    if (!depth) return propagate(depth);
    topics.depth = *depth;
  }
  return topics;
}

}  // namespace calib
