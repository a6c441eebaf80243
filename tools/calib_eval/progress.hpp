#pragma once

#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <mutex>
#include <string>

namespace calib::eval {

/// A bar on standard error that goes with what it stands for; nothing at all when that is not a terminal.
class Progress {
 public:
  Progress(std::string what, std::size_t total) : what_(std::move(what)), total_(total) { draw(); }
  ~Progress() {
    if (shown_) std::fputs("\r\x1b[K", stderr);
  }
  Progress(const Progress&) = delete;
  Progress& operator=(const Progress&) = delete;

  /// One more is done. May be called from any thread.
  void step() {
    const std::scoped_lock lock(mutex_);
    ++done_;
    const auto now = std::chrono::steady_clock::now();
    if (now - drawn_ < std::chrono::milliseconds(100)) return;
    drawn_ = now;
    draw();
  }

 private:
  void draw() const {
    if (!shown_) return;
    constexpr std::size_t width = 30;
    const std::size_t full = width * done_ / std::max<std::size_t>(total_, 1);
    const std::string bar = std::string(full, '#') + std::string(width - full, '.');
    std::fprintf(stderr, "\r\x1b[K%s [%s] %zu of %zu", what_.c_str(), bar.c_str(), done_, total_);
  }

  std::mutex mutex_;
  std::string what_;
  std::size_t total_, done_ = 0;
  std::chrono::steady_clock::time_point drawn_;
  bool shown_ = isatty(STDERR_FILENO) == 1;
};

}  // namespace calib::eval
