#include "message_ids.hpp"
#include "service.hpp"

namespace calib {
namespace {

std::string listed(const std::vector<std::string>& keys) {
  std::string text;
  for (const std::string& key : keys) text += (text.empty() ? "" : ", ") + escape_control(key);
  return text;
}

std::string in_words(const ConfigChanges& changes) {
  if (changes.taken_over.empty() && changes.need_restart.empty())
    return "the configuration was read again: nothing in it has changed";
  std::string text = "the configuration was read again";
  if (!changes.taken_over.empty()) text += "; taken over: " + listed(changes.taken_over);
  if (!changes.need_restart.empty())
    text +=
        "; needs a restart: " + listed(changes.need_restart) + " (stays as it was until `systemctl restart calibd`)";
  return text;
}

}  // namespace

Result<ConfigChanges> Service::reload() {
  auto wanted = surroundings_.read_config();
  {
    const std::lock_guard lock(mutex_);
    reload_refused_ = wanted ? "" : escape_control(wanted.error().context);
  }
  if (!wanted) {
    const std::string why = wanted.error().context + "; the configuration that calibd runs with stays in force";
    surroundings_.log(3, message_ids::configuration_refused,
                      {why, {.cause = std::string(to_string(wanted.error().code))}});
    surroundings_.status_changed();
    return fail(ErrorCode::failed, why);
  }
  ConfigChanges changes = take_over(*wanted, config_);
  for (const auto& pair : pairs_) {
    pair->pipeline = PairPipeline(pair_settings(config_, *pair->config, pair->pipeline.settings().evidence_sha256));
    while (pair->state.run.frames.size() > pair->pipeline.frames_to_keep()) pair->state.run.frames.pop_front();
  }
  ledger_.set_configuration(config_.sha256);
  surroundings_.log(changes.need_restart.empty() ? 5 : 4, message_ids::configuration_reloaded, in_words(changes));
  collect_status();
  return changes;
}

ControlReply Service::answer(const ReloadRequest&, const PendingRequest& pending) {
  const Peer& peer = pending.peer;
  if (!peer.may_change)
    return Error{ErrorCode::denied, "only root, the daemon's user and members of its group may ask for changes"};
  auto changes = reload();
  return changes ? ControlReply(std::move(*changes)) : ControlReply(changes.error());
}

}  // namespace calib
