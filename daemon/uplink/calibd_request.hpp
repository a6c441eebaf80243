#pragma once

#include <chrono>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>

#include "calib/result.hpp"

namespace calib::uplink {

/// One request to calibd (proto/control.md) at a time, without waiting for the reply.
class CalibdRequest {
 public:
  explicit CalibdRequest(std::filesystem::path socket) : path_(std::move(socket)) {}
  CalibdRequest(const CalibdRequest&) = delete;
  CalibdRequest& operator=(const CalibdRequest&) = delete;
  ~CalibdRequest() { cancel(); }

  /// Fails with `daemon_not_running`, `denied` or `failed`.
  [[nodiscard]] Result<void> send(const nlohmann::json& request, std::chrono::seconds timeout);
  /// Forgets what was asked last.
  void cancel();
  [[nodiscard]] bool is_waiting() const { return fd_ >= 0; }
  /// To be polled for input; -1 while nothing is asked.
  [[nodiscard]] int fd() const { return fd_; }
  /// The reply once it is there, an object with "ok": true. Fails with `no_answer`, `malformed_reply`, or the code of
  /// calibd's refusal.
  [[nodiscard]] std::optional<Result<nlohmann::json>> receive();

 private:
  std::filesystem::path path_;
  int fd_ = -1;
  std::string received_;
  std::chrono::steady_clock::time_point deadline_;
};

}  // namespace calib::uplink
