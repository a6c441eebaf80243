#include "dds/names.hpp"

#include <algorithm>

namespace calib {
namespace {

bool is_letter(char c) { return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z'); }
bool is_digit(char c) { return c >= '0' && c <= '9'; }

/// `/part/part...`: parts of letters, digits and single underscores that do not begin with a digit.
bool is_ros_name(std::string_view name) {
  if (name.size() < 2 || name.size() > 250 || name.front() != '/') return false;
  char before = 0;
  for (const char c : name) {
    const bool fits = c == '/' ? before != '/' : c == '_' ? before != '_' : is_digit(c) ? before != '/' : is_letter(c);
    if (!fits) return false;
    before = c;
  }
  return name.back() != '/';
}

}  // namespace

Result<std::string> dds_topic_name(std::string_view topic) {
  constexpr std::string_view raw = "dds:";
  if (topic.starts_with(raw)) {
    topic.remove_prefix(raw.size());
    const bool taken =
        std::ranges::all_of(topic, [](char c) { return is_letter(c) || is_digit(c) || c == '_' || c == '/'; });
    if (topic.empty() || topic.size() > 255 || !taken || is_digit(topic.front()))
      return fail(ErrorCode::bad_topic,
                  "a raw topic name is dds: and 1 .. 255 letters, digits, _ and /, no digit first");
    return std::string(topic);
  }
  if (!is_ros_name(topic))
    return fail(ErrorCode::bad_topic,
                "a topic is written as ROS 2 does, absolute: /lidar/points (or dds:NAME for a raw name)");
  return "rt" + std::string(topic);
}

std::string ros_topic_name(std::string_view dds_topic) {
  const bool ros = dds_topic.starts_with("rt") && is_ros_name(dds_topic.substr(2));
  return ros ? std::string(dds_topic.substr(2)) : "dds:" + std::string(dds_topic);
}

std::string ros_type_name(std::string_view dds_type) {
  constexpr std::string_view middle = "::dds_::";
  const auto at = dds_type.find(middle);
  const auto package = dds_type.substr(0, dds_type.find("::"));
  if (at == std::string_view::npos || at <= package.size() || !dds_type.ends_with('_')) return std::string(dds_type);
  const auto kind = dds_type.substr(package.size() + 2, at - package.size() - 2);  // msg
  const auto name = dds_type.substr(at + middle.size());
  return std::string(package) + '/' + std::string(kind) + '/' + std::string(name.substr(0, name.size() - 1));
}

bool is_compressed_topic(std::string_view topic) { return topic.ends_with("/compressed"); }

bool is_interface_name(std::string_view name) {
  constexpr std::string_view marks = ".:_@-";
  return !name.empty() && name.size() <= 64 && std::ranges::all_of(name, [&](char c) {
    return is_letter(c) || is_digit(c) || marks.find(c) != std::string_view::npos;
  });
}

bool is_peer_address(std::string_view text) {
  constexpr std::string_view marks = ".:-";
  return !text.empty() && text.size() <= 253 && std::ranges::all_of(text, [&](char c) {
    return is_letter(c) || is_digit(c) || marks.find(c) != std::string_view::npos;
  });
}

}  // namespace calib
