#include "dds/messages.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <new>
#include <utility>
#include <vector>

namespace calib {
namespace {

/// Escaped, because receivers show and log it, and because a C string ends at a zero byte.
char* dds_text(std::string_view text) { return dds_string_dup(escape_control(text).c_str()); }

builtin_interfaces_msg_dds__Time_ ros_time(WallTime time) {
  const auto seconds = std::chrono::floor<std::chrono::seconds>(time);
  return {static_cast<std::int32_t>(seconds.count()), static_cast<std::uint32_t>((time - seconds).count())};
}

template <typename Message>
Message* zeroed() {
  return new (dds_alloc(sizeof(Message))) Message{};
}

/// Allocates `size` zeroed elements for `sequence`.
template <typename Sequence>
auto make_room(Sequence& sequence, std::size_t size) {
  using Element = std::remove_pointer_t<decltype(sequence._buffer)>;
  sequence._length = sequence._maximum = static_cast<std::uint32_t>(size);
  sequence._release = true;
  sequence._buffer = size == 0 ? nullptr : static_cast<Element*>(dds_alloc(size * sizeof(Element)));
  std::uninitialized_value_construct_n(sequence._buffer, size);
  return std::span(sequence._buffer, size);
}

// Levels of a DiagnosticStatus.
constexpr std::uint8_t ok = 0, warn = 1, error = 2, stale = 3;

std::uint8_t level(Verdict verdict) {
  switch (verdict) {
    case Verdict::calibrated:
      return ok;
    case Verdict::suspect:
      return warn;
    case Verdict::drifted:
      return error;
    case Verdict::not_evaluated:
      break;
  }
  return stale;
}

using KeyValues = std::vector<std::pair<std::string, std::string>>;

void add_misalignment(const PairStatus::Misalignment& misalignment, KeyValues& values) {
  for (int i = 0; i < 6; ++i) {
    const double scale = i < 3 ? 1 / radians_per_degree : 100;
    const char* unit = i < 3 ? "deg" : "cm";
    values.emplace_back(fmt::format("misalignment {} [{}]", axis_names[i], unit),
                        fmt::format("{:.3f}", misalignment.delta[i] * scale));
    values.emplace_back(fmt::format("sigma {} [{}]", axis_names[i], unit),
                        fmt::format("{:.3f}", misalignment.sigma[i] * scale));
  }
}

void add_input(std::string_view name, const PairStatus::Input& input, KeyValues& values) {
  values.emplace_back(fmt::format("{} topic", name), input.topic);
  if (input.age_s) values.emplace_back(fmt::format("{} age [s]", name), fmt::format("{:.1f}", *input.age_s));
}

KeyValues key_values(const PairStatus& pair) {
  KeyValues values{
      {"verdict", std::string(to_string(pair.verdict))}, {"reason", pair.reason}, {"since", rfc3339(pair.since)}};
  if (pair.last_evaluated) values.emplace_back("last evaluated", rfc3339(*pair.last_evaluated));
  values.emplace_back("evaluated", std::to_string(pair.evaluated));
  for (const auto& [reason, count] : pair.skipped) values.emplace_back("skipped " + reason, std::to_string(count));
  for (const auto& [code, remark] : pair.remarks)
    values.emplace_back("remark " + code, fmt::format("{}, the last: {}", remark.count, remark.text));
  if (pair.score) {
    values.emplace_back("score", fmt::format("{:.6f}", pair.score->current));
    values.emplace_back("score best neighbour", fmt::format("{:.6f}", pair.score->best_neighbour));
    if (pair.score->baseline) values.emplace_back("score baseline", fmt::format("{:.6f}", *pair.score->baseline));
  }
  if (pair.misalignment) add_misalignment(*pair.misalignment, values);
  if (pair.record) {
    values.emplace_back("record sequence", std::to_string(pair.record->sequence));
    values.emplace_back("record verified", pair.record->verified ? "true" : "false");
  }
  if (pair.proposed) values.emplace_back("proposed record sequence", std::to_string(pair.proposed->record_sequence));
  add_input("image", pair.image, values);
  if (pair.right_image) add_input("right image", *pair.right_image, values);
  if (pair.depth) add_input("depth", *pair.depth, values);
  if (pair.motion) add_input("motion", *pair.motion, values);
  add_input("cloud", pair.cloud, values);
  if (pair.time_difference_ms)
    values.emplace_back("time difference [ms]", fmt::format("{:.1f}", *pair.time_difference_ms));
  return values;
}

}  // namespace

DiagnosticArrayMessage diagnostics_message(const Status& status, WallTime now) {
  DiagnosticArrayMessage message(zeroed<diagnostic_msgs_msg_dds__DiagnosticArray_>());
  message->header.stamp = ros_time(now);
  message->header.frame_id = dds_text("");
  const bool refused = status.signing_refused.has_value();
  const auto statuses = make_room(message->status, status.pairs.size() + (refused ? 1 : 0));
  for (std::size_t i = 0; i < status.pairs.size(); ++i) {
    const PairStatus& pair = status.pairs[i];
    const std::string verdict(to_string(pair.verdict));
    statuses[i].level = refused ? std::max(level(pair.verdict), warn) : level(pair.verdict);
    statuses[i].name = dds_text("calibd: " + pair.name);
    statuses[i].message = dds_text(pair.reason.empty() ? verdict : verdict + ": " + pair.reason);
    statuses[i].hardware_id = dds_text(status.vehicle);
    const KeyValues values = key_values(pair);
    std::ranges::transform(values, make_room(statuses[i].values, values.size()).begin(), [](const auto& value) {
      return diagnostic_msgs_msg_dds__KeyValue_{dds_text(value.first), dds_text(value.second)};
    });
  }
  if (refused) {
    auto& signing = statuses.back();
    signing.level = error;
    signing.name = dds_text("calibd: signing");
    signing.message = dds_text("refused: " + *status.signing_refused);
    signing.hardware_id = dds_text(status.vehicle);
  }
  return message;
}

TransformsMessage transforms_message(std::span<const ProposedExtrinsic> proposed, WallTime now) {
  TransformsMessage message(zeroed<tf2_msgs_msg_dds__TFMessage_>());
  std::ranges::transform(
      proposed, make_room(message->transforms, proposed.size()).begin(), [&](const ProposedExtrinsic& extrinsic) {
        const auto t = translation_m(extrinsic.T_camera_lidar);
        const auto q = quaternion_xyzw(extrinsic.T_camera_lidar);
        return geometry_msgs_msg_dds__TransformStamped_{{ros_time(now), dds_text(extrinsic.camera_frame)},
                                                        dds_text(extrinsic.lidar_frame),
                                                        {{t[0], t[1], t[2]}, {q[0], q[1], q[2], q[3]}}};
      });
  return message;
}

DriftAlertMessage drift_alert_message(const DriftAlert& alert) {
  DriftAlertMessage message(zeroed<calibd_msgs_msg_dds__DriftAlert_>());
  message->stamp = ros_time(alert.stamp);
  message->alert_sequence = alert.alert_sequence;
  message->vehicle = dds_text(alert.vehicle);
  message->pair = dds_text(alert.pair);
  message->verdict = dds_text(to_string(alert.verdict));
  message->previous_verdict = dds_text(to_string(alert.previous_verdict));
  message->reason = dds_text(alert.reason);
  for (int i = 0; i < 3; ++i) {
    message->rotation_rad[i] = alert.misalignment.delta[i];
    message->translation_m[i] = alert.misalignment.delta[i + 3];
    message->sigma_rotation_rad[i] = alert.misalignment.sigma[i];
    message->sigma_translation_m[i] = alert.misalignment.sigma[i + 3];
  }
  message->record_sequence = alert.record_sequence;
  return message;
}

}  // namespace calib
