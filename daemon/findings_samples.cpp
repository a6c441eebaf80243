#include <fmt/format.h>

#include <algorithm>
#include <iterator>
#include <numeric>
#include <utility>

#include "findings.hpp"
#include "message_faults.hpp"

namespace calib {
namespace {

using std::chrono::nanoseconds;

double seconds(nanoseconds time) { return std::chrono::duration<double>(time).count(); }

std::string counted(std::uint64_t count, std::string_view noun) {
  return fmt::format("{} {}{}", count, noun, count == 1 ? "" : "s");
}

std::string short_name(std::string_view name) {
  constexpr std::size_t longest = 80;
  return name.size() <= longest ? std::string(name) : std::string(name.substr(0, longest)) + "...";
}

/// Levenshtein distance.
std::size_t edit_distance(const std::string& a, const std::string& b) {
  std::vector<std::size_t> row(b.size() + 1);
  std::iota(row.begin(), row.end(), std::size_t{0});
  for (std::size_t i = 1; i <= a.size(); ++i) {
    std::size_t diagonal = std::exchange(row[0], i);
    for (std::size_t j = 1; j <= b.size(); ++j) {
      const std::size_t replaced = diagonal + (a[i - 1] == b[j - 1] ? 0 : 1);
      diagonal = row[j];
      row[j] = std::min({replaced, row[j] + 1, row[j - 1] + 1});
    }
  }
  return row.back();
}

/// The published topic of the right type, not in use otherwise, whose name is nearest by edit distance; the first of
/// equals.
const RemoteWriter* nearest_topic(const PairObservation& seen, const TopicObservation& topic) {
  const RemoteWriter* nearest = nullptr;
  std::size_t least = 0;
  for (const RemoteWriter& writer : seen.writers) {
    if (writer.type != topic.type || !writer.obstacle.empty() || seen.topics_in_use.contains(writer.topic)) continue;
    const std::size_t distance = edit_distance(short_name(writer.topic), short_name(topic.topic));
    if (nearest != nullptr && distance >= least) continue;
    nearest = &writer, least = distance;
  }
  return nearest;
}

Finding problem(const std::string& check, std::string code, std::string what, std::string cause, std::string remedy) {
  return {check, FindingResult::problem, std::move(code), std::move(what), std::move(cause), std::move(remedy)};
}

const MessageFault& fault_of(const std::string& code) {
  return message_fault(parse_error_code(code).value_or(ErrorCode::internal_error));
}

Finding not_published(const PairObservation& seen, const TopicObservation& topic) {
  if (const RemoteWriter* meant = nearest_topic(seen, topic))
    return problem(topic.check, "wrong_topic", "nobody publishes " + topic.topic,
                   fmt::format("the topic is probably {}, which carries {} and is not configured anywhere",
                               short_name(meant->topic), topic.type),
                   fmt::format("write {} as {}", short_name(meant->topic), topic.key));
  if (seen.writers.empty())
    return problem(
        topic.check, "nobody_heard", "nobody publishes " + topic.topic,
        fmt::format("no other DDS participant is found in domain {} on interface {}", seen.domain, seen.interface),
        "compare dds.domain with the vehicle's ROS_DOMAIN_ID and dds.interface with the network that its sensors are "
        "on; "
        "where the network lets no multicast through, write their addresses as dds.peers (CYCLONEDDS_URI is not read)");
  return problem(
      topic.check, "no_publisher", "nobody publishes " + topic.topic,
      fmt::format("its driver does not run, or publishes {} under a name that another setting uses", topic.type),
      fmt::format("start the driver, or write the right topic as {}", topic.key));
}

/// What publishers of other messages than calibd reads can be set to, or what can be read instead.
struct KnownType {
  std::string_view type;  // or its beginning
  std::string_view cause, remedy;
};
constexpr std::string_view packets = "it carries the sensor's packets, from which the driver computes its points";
constexpr std::string_view read_points = "write the driver's topic of points (sensor_msgs/msg/PointCloud2)";
constexpr std::string_view video = "it is a video stream, whose frames cannot be decoded one by one";
constexpr std::string_view read_images =
    "write the camera's own topic or its /compressed one, or have image_transport republish the stream as raw";
constexpr KnownType known_types[] = {
    {"livox_ros_driver2/msg/CustomMsg", "the Livox driver publishes its own message",
     "set xfer_format of the driver to 0 (PointCloud2), or have another node convert it"},
    {"livox_interfaces/msg/CustomMsg", "the Livox driver publishes its own message",
     "start the driver with its launch file for PointCloud2 (xfer_format 0)"},
    {"velodyne_msgs/", packets, read_points},
    {"ouster_sensor_msgs/", packets, read_points},
    {"ouster_msgs/", packets, read_points},
    {"hesai_ros_driver/", packets, read_points},
    {"rslidar_msg/", packets, read_points},
    {"nebula_msgs/", packets, read_points},
    {"point_cloud_interfaces/", "point_cloud_transport has compressed it",
     "write the topic without the name of the compression at its end, or have point_cloud_transport republish it as "
     "raw"},
    {"sensor_msgs/msg/LaserScan", "it is of a LiDAR with one plane, or a plane cut out of a cloud",
     "write the topic of the whole cloud; the extrinsic of a LiDAR with one plane cannot be watched"},
    {"sensor_msgs/msg/PointCloud", "it is the message that PointCloud2 has replaced",
     "have the driver or a converter publish sensor_msgs/msg/PointCloud2"},
    {"ffmpeg_image_transport_msgs/", video, read_images},
    {"foxglove_msgs/msg/CompressedVideo", video, read_images},
    {"theora_image_transport/", video, read_images},
};

const KnownType* known_type(std::string_view type) {
  const auto* const found = std::ranges::find_if(known_types, [&](const KnownType& known) {
    return known.type.ends_with('/') ? type.starts_with(known.type) : type == known.type;
  });
  return found == std::end(known_types) ? nullptr : found;
}

Finding of_other_type(const PairObservation& seen, const TopicObservation& topic, const RemoteWriter& writer) {
  const std::string what =
      fmt::format("{} carries {}, but {} is expected", topic.topic, short_name(writer.type), topic.type);
  const bool compressed = writer.type == "sensor_msgs/msg/CompressedImage";
  std::string remedy = compressed ? "publish it under a name that ends in /compressed, by which calibd recognises it"
                                  : "write a topic of " + topic.type + " as " + topic.key;
  const KnownType* const known = known_type(writer.type);
  if (known != nullptr) remedy = known->remedy;
  if (const RemoteWriter* meant = nearest_topic(seen, topic))
    remedy = fmt::format("write {} as {}, it carries {}", short_name(meant->topic), topic.key, topic.type);
  return problem(topic.check, "wrong_type", what,
                 std::string(known ? known->cause : "it is another topic than the one that was meant"),
                 std::move(remedy));
}

Finding nothing_usable(const TopicObservation& topic, const PairObservation& seen) {
  if (topic.malformed.empty())
    return problem(
        topic.check, "silent",
        fmt::format("{} has a publisher, but no message arrived in {}", topic.topic, duration_words(seen.listened)),
        "the driver waits for its sensor, or the messages are lost: they are large, and the "
        "kernel's receive buffer is small",
        "check the driver's log, and net.core.rmem_max (calibd's package sets it)");
  const auto& [code, count] =
      *std::ranges::max_element(topic.malformed, {}, [](const auto& each) { return each.second; });
  const MessageFault& fault = fault_of(code);
  Finding finding = problem(topic.check, code,
                            fmt::format("{} cannot be used: {}", counted(count, "message"), topic.malformed_context),
                            std::string(fault.cause), std::string(fault.remedy));
  // Nothing depends on a topic that is not configured.
  if (!topic.configured) finding.result = FindingResult::warning;
  return finding;
}

/// What was wrong in messages that were used all the same, the first by its code.
void add_remarks(const TopicObservation& topic, Finding& finding) {
  for (const auto& [code, remark] : topic.remarks) {
    finding.seen += "; " + remark.context;
    if (finding.result != FindingResult::ok) continue;
    const MessageFault& fault = message_fault(remark.code);
    finding.result = FindingResult::warning;
    finding.code = code;
    finding.cause = fault.cause;
    finding.remedy = fault.remedy;
  }
}

Finding judge_topic(const PairObservation& seen, const TopicObservation& topic) {
  std::vector<const RemoteWriter*> fitting, others;
  for (const RemoteWriter& writer : seen.writers)
    if (writer.topic == topic.topic) (writer.type == topic.type ? fitting : others).push_back(&writer);
  if (!topic.configured && fitting.empty() && topic.messages == 0)
    return {topic.check, FindingResult::not_checked, {}, "nobody publishes " + topic.topic, {}, {}};
  // Messages may have come from a writer that no longer exists.
  if (topic.messages == 0 && fitting.empty())
    return others.empty() ? not_published(seen, topic) : of_other_type(seen, topic, *others.front());
  const auto blocked = std::ranges::find_if(fitting, [](const auto* writer) { return !writer->obstacle.empty(); });
  if (topic.messages == 0 && blocked != fitting.end())
    return problem(topic.check, "qos_mismatch", fmt::format("{} is published, but cannot be read", topic.topic),
                   (*blocked)->obstacle,
                   "change the publisher's quality of service, for example to ROS 2's sensor data profile");
  if (topic.messages == 0) return nothing_usable(topic, seen);

  Finding finding{topic.check, FindingResult::ok, {}, {}, {}, {}};
  finding.seen =
      fmt::format("{}: {} in {}", topic.topic, counted(topic.messages, "message"), duration_words(seen.listened));
  if (!topic.malformed.empty()) {
    finding.result = FindingResult::warning;
    finding.code = topic.malformed.begin()->first;
    finding.seen += "; others cannot be used: " + topic.malformed_context;
    finding.cause = fault_of(finding.code).cause;
    finding.remedy = fault_of(finding.code).remedy;
  } else if (fitting.size() > 1) {
    finding.result = FindingResult::warning;
    finding.code = "several_publishers";
    finding.seen += fmt::format(" of {} publishers", fitting.size());
    finding.cause = "two drivers, or a driver and a replay, publish the same topic";
    finding.remedy = "stop all but one of them";
  }
  add_remarks(topic, finding);
  return finding;
}

/// Which frames an extrinsic that is proposed would name.
Finding judge_frames(const PairObservation& seen) {
  const auto frame_of = [&](std::string_view check) {
    const auto topic = std::ranges::find(seen.topics, check, &TopicObservation::check);
    return topic == seen.topics.end() ? std::string() : topic->frame_id;
  };
  std::string what, differing, keys;
  const auto look = [&](std::string_view check, const FrameName& configured) {
    const std::string frame = frame_of(check);
    what += fmt::format("{}{}: {}", what.empty() ? "" : ", ", check, frame.empty() ? "no frame" : "'" + frame + "'");
    if (!configured.is_given || frame.empty() || frame == configured.name) return;
    differing += fmt::format("{}{} is '{}'", differing.empty() ? "" : ", ", configured.key, configured.name);
    keys += (keys.empty() ? "" : " and ") + std::string(configured.key);
  };
  look("image", seen.camera_frame);
  look("cloud", seen.lidar_frame);
  if (!differing.empty())
    return {"frames",
            FindingResult::warning,
            std::string(to_string(ErrorCode::frame_id_mismatch)),
            what + "; " + differing,
            "the configuration names a frame that these sensors do not have, and so does every extrinsic that calibd "
            "publishes",
            "leave " + keys + " out to have the frames of the messages, or write those"};
  if (frame_of("image").empty() && frame_of("cloud").empty())
    return {"frames", FindingResult::not_checked, {}, "no message names a frame", {}, {}};
  return {"frames", FindingResult::ok, {}, what, {}, {}};
}

bool has_clock(const TopicObservation& topic) {
  return topic.age.has_value() && topic.check != "camera_info" && topic.check != "right_camera_info";
}

/// Whether a stamp is further from the arrival of its message than exposure, readout, transport and load explain.
bool is_off(nanoseconds age) { return age > std::chrono::seconds(2) || age < -std::chrono::milliseconds(500); }

std::string age_words(const TopicObservation& topic) {
  return fmt::format("{} is stamped {} {} calibd's clock", topic.topic, duration_words(*topic.age),
                     *topic.age < nanoseconds(0) ? "ahead of" : "behind");
}

Finding judge_clock(const PairObservation& seen) {
  std::vector<const TopicObservation*> timed, off;
  for (const TopicObservation& topic : seen.topics)
    if (has_clock(topic)) timed.push_back(&topic);
  if (timed.empty()) return {"clock", FindingResult::not_checked, {}, "no message with a stamp arrived", {}, {}};
  for (const TopicObservation* topic : timed) {
    if (topic->messages >= 3 && topic->repeated_stamps + 1 >= topic->messages)
      return problem("clock", "stamps_stand_still",
                     fmt::format("{} messages of {} have the same stamp", topic->messages, topic->topic),
                     "the driver does not update header.stamp",
                     "make the driver stamp each message with the time of its measurement");
    if (is_off(*topic->age)) off.push_back(topic);
  }
  nanoseconds furthest{};
  std::string what;
  for (const TopicObservation* topic : timed) {
    furthest = std::max(furthest, std::chrono::abs(*topic->age));
    what += (what.empty() ? "" : ", ") + age_words(*topic);
  }
  if (off.empty())
    return {"clock", FindingResult::ok, {}, "stamps are within " + duration_words(furthest) + " of calibd's clock", {},
            {}};
  const bool ahead = *off.front()->age < nanoseconds(0);
  const auto far_apart = [&](const TopicObservation* topic) { return is_off(*topic->age - *off.front()->age); };
  const bool alike = off.size() == timed.size() && std::ranges::none_of(timed, far_apart);
  if (alike && timed.size() > 1)
    return problem("clock", ahead ? "clock_ahead" : "stale_clock", what,
                   "recorded or simulated data is played, or the clock of this computer is wrong",
                   "synchronise the clocks by NTP or PTP; nothing needs to be done for recorded data");
  return problem("clock", ahead ? "clock_ahead" : "stale_clock", what,
                 fmt::format("the clock of {} is not synchronised with the others", off.front()->topic),
                 "synchronise the sensor's clock (PTP, GPS), or make its driver stamp with the computer's clock");
}

Finding judge_pairing(const PairObservation& seen, const std::vector<Finding>& findings) {
  if (seen.time_difference)
    return {
        "pairing", FindingResult::ok,
        {},        fmt::format("image and cloud are {:.1f} ms apart", std::abs(seconds(*seen.time_difference)) * 1000),
        {},        {}};
  if (has_problem(findings, {"image", "right_image", "cloud", "depth_topic", "clock"}))
    return {"pairing", FindingResult::not_checked,
            {},        "an image, its depth or a cloud is missing, or stamps are wrong",
            {},        {}};
  if (seen.companion_mismatch || (seen.image && *seen.image != ImageSize{seen.camera.width(), seen.camera.height()}))
    return {"pairing", FindingResult::not_checked, {}, "images have another size", {}, {}};
  const Error& error = seen.time_difference.error();
  return problem("pairing", std::string(to_string(error.code)), error.context,
                 "the sensors are not triggered together, or one is stamped late",
                 "synchronise the sensors, or raise sampling.max_time_difference if the vehicle is slow enough for it");
}

}  // namespace

void diagnose_samples(const PairObservation& seen, std::vector<Finding>& findings) {
  for (const TopicObservation& topic : seen.topics) findings.push_back(judge_topic(seen, topic));
  findings.push_back(judge_clock(seen));
  findings.push_back(judge_frames(seen));
  findings.push_back(judge_pairing(seen, findings));
}

}  // namespace calib
