#include "calib/wall_time.hpp"

#include <algorithm>
#include <array>
#include <charconv>
#include <cstdint>

namespace calib {
namespace {

using std::chrono::days;
using std::chrono::nanoseconds;

/// `number` with zeros in front up to `width` digits.
std::string padded(std::int64_t number, std::size_t width) {
  const std::string digits = std::to_string(number);
  return std::string(width - std::min(width, digits.size()), '0') + digits;
}

std::string seconds_text(WallTime time) {
  const auto day = std::chrono::floor<days>(time);
  const std::chrono::year_month_day date{std::chrono::sys_days{day}};
  const std::chrono::hh_mm_ss clock{std::chrono::floor<std::chrono::seconds>(time - day)};
  return padded(static_cast<int>(date.year()), 4) + '-' + padded(static_cast<unsigned>(date.month()), 2) + '-' +
         padded(static_cast<unsigned>(date.day()), 2) + 'T' + padded(clock.hours().count(), 2) + ':' +
         padded(clock.minutes().count(), 2) + ':' + padded(clock.seconds().count(), 2);
}

std::string with_decimals(WallTime time, int decimals) {
  const nanoseconds fraction = time - std::chrono::floor<std::chrono::seconds>(time);
  return seconds_text(time) + '.' + padded(fraction.count(), 9).substr(0, decimals) + 'Z';
}

/// The value of `text` when it is all digits; -1 otherwise.
int digits_value(std::string_view text) {
  int value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  const bool all_digits = text.find_first_not_of("0123456789") == std::string_view::npos;
  return all_digits && error == std::errc{} && end == text.data() + text.size() ? value : -1;
}

}  // namespace

std::string rfc3339(WallTime time) { return with_decimals(time, 3); }

std::string rfc3339_ns(WallTime time) { return with_decimals(time, 9); }

Result<WallTime> parse_rfc3339(std::string_view text) {
  const auto bad = [&] {
    return fail(ErrorCode::bad_time, "'" + std::string(text) + "' is not a time like 2026-01-31T12:00:00.000Z");
  };
  constexpr std::string_view shape = "dddd-dd-ddTdd:dd:dd";
  if (text.size() <= shape.size() || text.size() > shape.size() + 11 || text.back() != 'Z') return bad();
  for (std::size_t i = 0; i < shape.size(); ++i)
    if (shape[i] != 'd' && text[i] != shape[i]) return bad();
  const auto field = [&](std::size_t at, std::size_t length) { return digits_value(text.substr(at, length)); };

  std::string fraction(text.substr(shape.size(), text.size() - shape.size() - 1));
  if (!fraction.empty() && (fraction.front() != '.' || fraction.size() < 2)) return bad();
  fraction.erase(0, 1);
  fraction.resize(9, '0');

  const std::array<int, 7> part{field(0, 4),  field(5, 2),  field(8, 2),           field(11, 2),
                                field(14, 2), field(17, 2), digits_value(fraction)};
  for (const int value : part)
    if (value < 0) return bad();
  const std::chrono::year_month_day date{std::chrono::year(part[0]), std::chrono::month(part[1]),
                                         std::chrono::day(part[2])};
  if (!date.ok() || part[0] < 1678 || part[0] > 2261 || part[3] > 23 || part[4] > 59 || part[5] > 59) return bad();
  return std::chrono::sys_days(date).time_since_epoch() + std::chrono::hours(part[3]) + std::chrono::minutes(part[4]) +
         std::chrono::seconds(part[5]) + nanoseconds(part[6]);
}

}  // namespace calib
