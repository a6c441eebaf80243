#include "table.hpp"

#include <algorithm>

#include "calib/result.hpp"

namespace calib::ctl {
namespace {

constexpr std::size_t gap = 2;        // between columns
constexpr std::size_t narrowest = 8;  // first column

}  // namespace

void Table::row(std::vector<Cell> cells) {
  for (Cell& cell : cells) cell.text = escape_control(cell.text);
  rows_.push_back({std::move(cells), {}});
}

void Table::detail(std::string_view text) {
  for (std::string& line : wrap(escape_control(text), Text::max_width - detail_indent))
    rows_.back().details.push_back(std::move(line));
}

std::string Table::str() const {
  std::vector<std::size_t> widths;
  std::size_t total = 0;
  for (std::size_t column = 0; column < header_.size(); ++column) {
    std::size_t width = header_[column].size();
    for (const Row& row : rows_) width = std::max(width, row.cells[column].text.size());
    widths.push_back(width);
    total += width + (column == 0 ? 0 : gap);
  }
  if (total > Text::max_width) {
    const std::size_t excess = total - Text::max_width;
    widths[0] = std::max(std::min(narrowest, widths[0]), widths[0] - std::min(widths[0], excess));
  }
  std::string text;
  const auto line = [&](const auto& cells, auto&& text_of, auto&& colour_of) {
    for (std::size_t column = 0; column < cells.size(); ++column) {
      const std::string shown = column == 0 ? cut(text_of(cells[0]), widths[0]) : text_of(cells[column]);
      text += coloured_ ? painted(shown, colour_of(cells[column])) : shown;
      if (column + 1 < cells.size()) text.append(widths[column] - std::min(widths[column], shown.size()) + gap, ' ');
    }
    text += '\n';
  };
  line(
      header_, [](const std::string& title) { return title; }, [](const std::string&) { return Colour::none; });
  for (const Row& row : rows_) {
    line(
        row.cells, [](const Cell& cell) { return cell.text; }, [](const Cell& cell) { return cell.colour; });
    for (const std::string& detail : row.details) text.append(detail_indent, ' ').append(detail) += '\n';
  }
  return text;
}

std::string cut(std::string text, std::size_t width) {
  constexpr std::string_view dots = "...";
  if (text.size() <= width) return text;
  std::size_t end = width - std::min(width, dots.size());
  while (end > 0 && (static_cast<unsigned char>(text[end]) & 0xc0) == 0x80) --end;
  return text.substr(0, end).append(dots);
}

}  // namespace calib::ctl
