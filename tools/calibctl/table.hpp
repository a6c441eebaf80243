#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "text.hpp"

namespace calib::ctl {

/// Aligned columns under a header, at most `Text::max_width` wide: the first column is cut where there is not room
/// enough for all. Every cell passes `escape_control`.
class Table {
 public:
  struct Cell {
    std::string text;
    Colour colour = Colour::none;
  };

  explicit Table(std::vector<std::string> header, bool coloured) : header_(std::move(header)), coloured_(coloured) {}
  /// As many cells as the header has.
  void row(std::vector<Cell> cells);
  /// Below the last row, indented by `detail_indent` and wrapped.
  void detail(std::string_view text);
  [[nodiscard]] std::string str() const;

  static constexpr std::size_t detail_indent = 6;

 private:
  struct Row {
    std::vector<Cell> cells;
    std::vector<std::string> details;  // lines
  };
  std::vector<std::string> header_;
  bool coloured_;
  std::vector<Row> rows_;
};

/// At most `width` bytes of `text`, the last three of them "..." if something is missing. Cuts no UTF-8 character.
[[nodiscard]] std::string cut(std::string text, std::size_t width);

}  // namespace calib::ctl
