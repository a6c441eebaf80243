#include "text.hpp"

#include <unistd.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <nlohmann/json.hpp>

#include "calib/result.hpp"

namespace calib::ctl {
namespace {

constexpr std::size_t label_width = 16;

/// A LiDAR's axes are x forward, y left, z up, so by the right hand a positive roll lowers the right side, a
/// positive pitch the nose, and a positive yaw turns to the left.
struct AxisWords {
  std::string_view label, positive, negative;
};
constexpr std::array<AxisWords, 6> axis_words{{{"Roll", "right side down", "left side down"},
                                               {"Pitch", "nose down", "nose up"},
                                               {"Yaw", "to the left", "to the right"},
                                               {"X", "forward", "back"},
                                               {"Y", "to the left", "to the right"},
                                               {"Z", "up", "down"}}};

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
  return ::isatty(STDOUT_FILENO) == 1 && (no_colour == nullptr || *no_colour == '\0') &&
         terminal != nullptr && std::string_view(terminal) != "dumb";
}

void Text::line(std::string_view label, std::string_view value, Colour colour) {
  text_.append(label).append(label_width - std::min(label_width, label.size()), ' ').append(": ");
  const bool paint = coloured_ && colour != Colour::none;
  if (paint) text_ += escape_sequence(colour);
  text_ += escape_control(value);
  if (paint) text_ += "\x1b[0m";
  text_ += '\n';
}

void Text::motion(const Vector6& delta, const Vector6* sigma) {
  for (int i = 0; i < 6; ++i) {
    const bool is_angle = i < 3;
    const int places = is_angle ? 2 : 1;
    const double scale = is_angle ? 1 / radians_per_degree : 100;
    const std::string amount = decimals(std::abs(delta[i]) * scale, places);
    const bool is_zero = amount.find_first_of("123456789") == std::string::npos;
    std::string value = amount + (is_angle ? " degrees" : " cm");
    if (!is_zero) value.append(" ").append(delta[i] > 0 ? axis_words[i].positive : axis_words[i].negative);
    if (sigma != nullptr) value += " (+/- " + decimals((*sigma)[i] * scale, places) + ")";
    line(axis_words[i].label, value);
  }
}

void Text::transform(std::string_view label, const RigidTransform& transform) {
  line(label, "translation " + listed(translation_m(transform)) + " m");
  line("", "quaternion x y z w " + listed(quaternion_xyzw(transform)));
}

std::string decimals(double value, int places) {
  std::array<char, 512> text;
  std::snprintf(text.data(), text.size(), "%.*f", places, value);
  return text.data();
}

std::string how_far(const RigidTransform& motion) {
  return decimals(rotation_angle_rad(motion) / radians_per_degree, 2) + " degrees and " +
         decimals(motion.translation().norm() * 100, 1) + " cm";
}

std::string json_text(const nlohmann::json& value, int indent) {
  return value.dump(indent, ' ', /*ensure_ascii=*/true, nlohmann::json::error_handler_t::replace) + '\n';
}

std::string counted(std::uint64_t count, std::string_view noun) {
  return std::to_string(count) + ' ' + std::string(noun) + (count == 1 ? "" : "s");
}

}  // namespace calib::ctl
