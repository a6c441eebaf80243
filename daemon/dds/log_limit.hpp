#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <mutex>
#include <optional>
#include <string>
#include <string_view>

namespace calib {

/// Lets a few lines a minute of somebody else's log through and counts the others, so that who can provoke a line
/// cannot fill a disk. What is counted is told once a minute, and at the end. Thread-safe.
class LogLimit {
 public:
  using Clock = std::function<std::chrono::steady_clock::time_point()>;
  /// One line, with syslog's priority. Control characters are still in it.
  using Write = std::function<void(int priority, const std::string& line)>;
  static constexpr int lines_per_minute = 10;
  static constexpr std::size_t longest_line = 300;

  /// `who` begins each line.
  LogLimit(std::string who, Clock clock, Write write)
      : who_(std::move(who)), clock_(std::move(clock)), write_(std::move(write)) {}
  LogLimit(const LogLimit&) = delete;
  LogLimit& operator=(const LogLimit&) = delete;
  ~LogLimit() { tell(); }

  void log(int priority, std::string_view text);
  /// To be called now and then: tells what was counted in the last minute, once that is over.
  void tell_if_due();

 private:
  void tell();
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
