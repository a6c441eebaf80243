#include "dds/log_limit.hpp"

#include <fmt/format.h>

namespace calib {
namespace {

constexpr int warning = 4;

}  // namespace

void LogLimit::log(int priority, std::string_view text) {
  text = text.substr(0, text.find('\n')).substr(0, longest_line);
  std::optional<std::string> summary;
  bool passes = false;
  {
    const std::lock_guard lock(mutex_);
    const auto now = clock_();
    summary = end_minute(now);
    if (!minute_) minute_ = now;
    passes = lines_++ < lines_per_minute;
    if (!passes) last_ = text;
  }
  if (summary) write_(warning, *summary);
  if (passes) write_(priority, fmt::format("{}: {}", who_, text));
}

void LogLimit::report_if_due() {
  std::optional<std::string> summary;
  {
    const std::lock_guard lock(mutex_);
    summary = end_minute(clock_());
  }
  if (summary) write_(warning, *summary);
}

void LogLimit::report() {
  std::optional<std::string> summary;
  {
    const std::lock_guard lock(mutex_);
    summary = end_minute(std::chrono::steady_clock::time_point::max());
  }
  if (summary) write_(warning, *summary);
}

/// Starts a new minute if the last one is over. Returns the line that reports the last one, if it has something to
/// report.
std::optional<std::string> LogLimit::end_minute(std::chrono::steady_clock::time_point now) {
  if (!minute_ || now - *minute_ < std::chrono::minutes(1)) return std::nullopt;
  const std::uint64_t counted = lines_ > lines_per_minute ? lines_ - lines_per_minute : 0;
  minute_.reset();
  lines_ = 0;
  if (counted == 0) return std::nullopt;
  return fmt::format("{}: {} more messages in the last minute, the last: {}", who_, counted, last_);
}

}  // namespace calib
