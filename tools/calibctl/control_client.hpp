#pragma once

#include <chrono>
#include <filesystem>
#include <functional>
#include <nlohmann/json.hpp>

#include "calib/result.hpp"

namespace calib::ctl {

/// Asks calibd one question (proto/control.md) and returns its reply, an object with "ok": true. `waiting` is
/// called about once a second while there is no reply. Fails with `daemon_not_running`, `denied`,
/// `no_answer`, `malformed_reply`, or with the code of calibd's refusal; `failed` where this version does not know it.
[[nodiscard]] Result<nlohmann::json> ask(const std::filesystem::path& socket, const nlohmann::json& question,
                                         std::chrono::seconds patience,
                                         const std::function<void(std::chrono::seconds)>& waiting);

/// For `waiting`: a line on standard error that tells of it, where that is a terminal; and away with it.
void show_waiting(std::chrono::seconds waited);
void clear_waiting();

}  // namespace calib::ctl
