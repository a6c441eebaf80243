#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <mutex>
#include <optional>
#include <string>
#include <string_view>

namespace calib {

/// Limits the rate of another library's log: writes a few lines a minute and counts the others, so that whoever can
/// cause a line cannot fill the disk. Reports the count once a minute and when it is destroyed. Thread-safe.
class LogLimit {
 public:
  using Clock = std::function<std::chrono::steady_clock::time_point()>;
  /// One line, with its syslog priority. Control characters are not escaped.
  using Write = std::function<void(int priority, const std::string& line)>;
  static constexpr int lines_per_minute = 10;
  static constexpr std::size_t longest_line = 300;

  /// Each line begins with `who`.
  LogLimit(std::string who, Clock clock, Write write)
      : who_(std::move(who)), clock_(std::move(clock)), write_(std::move(write)) {}
  LogLimit(const LogLimit&) = delete;
  LogLimit& operator=(const LogLimit&) = delete;
  ~LogLimit() { report(); }

  void log(int priority, std::string_view text);
  /// To be called at intervals: once a minute is over, reports how many of its lines were not written.
  void report_if_due();

 private:
  void report();
  [[nodiscard]] std::optional<std::string> end_minute(std::chrono::steady_clock::time_point now);

  std::string who_;
  Clock clock_;
  Write write_;
  std::mutex mutex_;  // guards what is below
  std::optional<std::chrono::steady_clock::time_point> minute_;
  std::uint64_t lines_ = 0;
  std::string last_;
};

}  // namespace calib
