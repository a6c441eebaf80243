#include "text.hpp"

#include <unistd.h>

#include <algorithm>
#include <array>
#include <cstdio>
#include <cstdlib>
#include <nlohmann/json.hpp>

#include "calib/axis_words.hpp"
#include "calib/result.hpp"

namespace calib::ctl {
namespace {

constexpr std::size_t label_width = 16;
constexpr std::string_view separator = ": ";

std::string_view escape_sequence(Colour colour) {
  switch (colour) {
    case Colour::red:
      return "\x1b[31m";
    case Colour::yellow:
      return "\x1b[33m";
    case Colour::green:
      return "\x1b[32m";
    case Colour::none:
      break;
  }
  return "";
}

template <std::size_t N>
std::string listed(const std::array<double, N>& values) {
  std::string text;
  for (const double value : values) text += (text.empty() ? "" : ", ") + decimals(value, 6);
  return text;
}

}  // namespace

bool terminal_has_colours() {
  const char* const no_colour = std::getenv("NO_COLOR");
  const char* const terminal = std::getenv("TERM");
  return ::isatty(STDOUT_FILENO) == 1 && (no_colour == nullptr || *no_colour == '\0') && terminal != nullptr &&
         std::string_view(terminal) != "dumb";
}

std::string painted(std::string_view text, Colour colour) {
  const std::string_view escape = escape_sequence(colour);
  return std::string(escape).append(text).append(escape.empty() ? "" : "\x1b[0m");
}

std::vector<std::string> wrap(std::string_view text, std::size_t width) {
  std::vector<std::string> lines;
  while (text.size() > width) {
    auto space = text.rfind(' ', width);
    if (space == std::string_view::npos) space = text.find(' ');
    if (space == std::string_view::npos) break;
    lines.emplace_back(text.substr(0, space));
    text.remove_prefix(space + 1);
  }
  lines.emplace_back(text);
  return lines;
}

void Text::line(std::string_view label, std::string_view value, Colour colour) {
  escaped_line(label, escape_control(value), colour);
}

void Text::escaped_line(std::string_view label, std::string_view escaped, Colour colour) {
  text_.append(label).append(label_width - std::min(label_width, label.size()), ' ').append(separator);
  text_.append(coloured_ ? painted(escaped, colour) : std::string(escaped)) += '\n';
}

void Text::wrapped(std::string_view label, std::string_view value, Colour colour) {
  for (const std::string& line : wrap(escape_control(value), max_width - label_width - separator.size())) {
    escaped_line(label, line, colour);
    label = "";
  }
}

void Text::parts(std::string_view label, std::string_view value) {
  constexpr std::string_view between = "; ";
  for (auto end = value.find(between); end != std::string_view::npos; end = value.find(between)) {
    wrapped(label, value.substr(0, end));
    value.remove_prefix(end + between.size());
    label = "";
  }
  wrapped(label, value);
}

void Text::motion(const Vector6& delta, const Vector6* sigma) {
  for (int axis = 0; axis < 6; ++axis)
    line(axis_label(axis),
         motion_in_words(axis, delta[axis], sigma == nullptr ? std::nullopt : std::optional((*sigma)[axis])));
}

void Text::transform(std::string_view label, const RigidTransform& transform) {
  line(label, "translation " + listed(translation_m(transform)) + " m");
  line("", "quaternion x y z w " + listed(quaternion_xyzw(transform)));
}

std::string axis_label(int axis) {
  std::string label(axis_names[static_cast<std::size_t>(axis)]);
  label[0] = static_cast<char>(label[0] - 'a' + 'A');
  return label;
}

std::string decimals(double value, int paths) {
  std::array<char, 512> text;
  std::snprintf(text.data(), text.size(), "%.*f", paths, value);
  return text.data();
}

std::string how_far(const RigidTransform& motion) {
  return decimals(rotation_angle_rad(motion) / radians_per_degree, 2) + " degrees and " +
         decimals(motion.translation().norm() * 100, 1) + " cm";
}

nlohmann::json parse_json(std::string_view text) {
  constexpr int deepest = 64;
  bool too_deep = false;
  auto json = nlohmann::json::parse(
      text,
      [&](int depth, nlohmann::json::parse_event_t, nlohmann::json&) {
        too_deep = too_deep || depth > deepest;
        return !too_deep;
      },
      /*allow_exceptions=*/false);
  return too_deep ? nlohmann::json(nlohmann::json::value_t::discarded) : json;
}

std::string json_text(const nlohmann::json& value, int indent) {
  return value.dump(indent, ' ', /*ensure_ascii=*/true, nlohmann::json::error_handler_t::replace) + '\n';
}

std::string counted(std::uint64_t count, std::string_view noun) {
  return std::to_string(count) + ' ' + std::string(noun) + (count == 1 ? "" : "s");
}

}  // namespace calib::ctl
