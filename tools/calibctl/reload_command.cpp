#include <iostream>

#include "commands.hpp"
#include "control_client.hpp"
#include "text.hpp"

namespace calib::ctl {
namespace {

using nlohmann::json;

/// The pair that is being sampled, or a recalibration, comes first; systemd waits for 90 s.
constexpr std::chrono::seconds timeout{80};

std::string listed(const json& keys) {
  std::string text;
  for (const json& key : keys.get_ref<const json::array_t&>())
    text += (text.empty() ? "" : ", ") + key.get<std::string>();
  return text.empty() ? "-" : text;
}

}  // namespace

Exit reload(const Paths& paths, bool as_json) {
  const auto reply = ask(paths.socket, {{"schema", 1}, {"request", "reload"}}, timeout, show_waiting);
  clear_waiting();
  if (!reply) return print_error(reply.error());
  if (as_json) {
    std::cout << json_text(*reply, 2);
    return Exit::done;
  }
  try {
    Text text(/*coloured=*/false);
    text.wrapped("Taken over", listed(reply->at("taken_over")));
    text.wrapped("Needs a restart", listed(reply->at("need_restart")));
    std::cout << text.str();
    return Exit::done;
  } catch (const json::exception& error) {
    return print_error(
        {ErrorCode::malformed_reply, std::string("calibd answered in a form that is not understood: ") + error.what()});
  }
}

}  // namespace calib::ctl
