#pragma once

#include <cstdint>
#include <nlohmann/json_fwd.hpp>
#include <string>
#include <string_view>
#include <vector>

#include "calib/geometry.hpp"

namespace calib::ctl {

enum class Colour { none, red, yellow, green };

/// True when standard output is a terminal that shows colours and NO_COLOR is not set.
[[nodiscard]] bool terminal_has_colours();

/// `text` in that colour.
[[nodiscard]] std::string painted(std::string_view text, Colour colour);
/// Lines of at most `width` bytes, broken at spaces. A word that is longer stays in one piece.
[[nodiscard]] std::vector<std::string> wrap(std::string_view text, std::size_t width);

/// Lines of label, colon and value. Every value passes `escape_control`, so that no text from outside controls the
/// terminal.
class Text {
 public:
  static constexpr std::size_t max_width = 100;

  explicit Text(bool coloured) : coloured_(coloured) {}
  void line(std::string_view label, std::string_view value, Colour colour = Colour::none);
  /// Lines of at most `max_width` characters, broken at spaces. Those after the first have no label. A word that is
  /// longer stays in one piece.
  void wrapped(std::string_view label, std::string_view value, Colour colour = Colour::none);
  /// A line for each part of `value` that "; " separates, wrapped.
  void parts(std::string_view label, std::string_view value);
  void blank() { text_ += '\n'; }
  /// Six lines: how far the LiDAR moved (rad, m) along its own axes, with words for the signs; `sigma` may be null.
  void motion(const Vector6& delta, const Vector6* sigma);
  /// Two lines: translation and quaternion.
  void transform(std::string_view label, const RigidTransform& transform);
  [[nodiscard]] const std::string& str() const { return text_; }

 private:
  void escaped_line(std::string_view label, std::string_view escaped, Colour colour);

  bool coloured_;
  std::string text_;
};

/// `Roll`, `Pitch`, `Yaw`, `X`, `Y`, `Z`.
[[nodiscard]] std::string axis_label(int axis);
[[nodiscard]] std::string decimals(double value, int paths);
/// `1.02 degrees and 3.1 cm`.
[[nodiscard]] std::string how_far(const RigidTransform& motion);
/// `discarded` when `text` is not JSON, or is nested deeper than 64: functions that visit a value are recursive.
[[nodiscard]] nlohmann::json parse_json(std::string_view text);
/// JSON and a newline; ASCII only, so that no text from outside controls a terminal.
[[nodiscard]] std::string json_text(const nlohmann::json& value, int indent);
/// `1 record`, `2 records`.
[[nodiscard]] std::string counted(std::uint64_t count, std::string_view noun);

}  // namespace calib::ctl
