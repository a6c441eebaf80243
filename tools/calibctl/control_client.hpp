#pragma once

#include <chrono>
#include <filesystem>
#include <functional>
#include <nlohmann/json.hpp>

#include "calib/result.hpp"

namespace calib::ctl {

/// Sends a request (proto/control.md) to calibd and returns the reply, an object with "ok": true. Calls `waiting` about
/// once a second until the reply arrives. Fails with `daemon_not_running`, `denied`, `no_answer`, `malformed_reply`, or
/// with the code of calibd's refusal; a code that this version does not know is `failed`. `file` is an open file that
/// is sent along.
[[nodiscard]] Result<nlohmann::json> ask(const std::filesystem::path& socket, const nlohmann::json& question,
                                         std::chrono::seconds timeout,
                                         const std::function<void(std::chrono::seconds)>& waiting, int file = -1);

/// For `waiting`: shows a line on standard error, if that is a terminal, and removes it.
void show_waiting(std::chrono::seconds waited);
void clear_waiting();

}  // namespace calib::ctl
