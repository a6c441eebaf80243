#include <nlohmann/json.hpp>

#include "journal.hpp"
#include "message_ids.hpp"
#include "service.hpp"
#include "snapshot.hpp"
#include "version.hpp"

namespace calib {
namespace {

using nlohmann::json;

PairStatus::Input input(const std::string& topic, const std::optional<std::chrono::steady_clock::time_point>& last) {
  PairStatus::Input shown{topic, std::nullopt};
  if (last) shown.age_s = std::chrono::duration<double>(std::chrono::steady_clock::now() - *last).count();
  return shown;
}

}  // namespace

PairStatus Service::status_of(const Watch& watch) const {
  PairStatus status = watch.pair->status();
  status.image = input(watch.topics.image, watch.image.last);
  status.cloud = input(watch.topics.cloud, watch.cloud.last);
  if (watch.topics.right_image) status.right_image = input(*watch.topics.right_image, watch.right_image.last);
  if (watch.topics.depth) status.depth = input(watch.topics.depth->name, watch.depth_image.last);
  if (watch.topics.motion) status.motion = input(watch.topics.motion->name, watch.motion.last);
  if (watch.time_difference)
    status.time_difference_ms = std::chrono::duration<double, std::milli>(*watch.time_difference).count();
  return status;
}

void Service::collect_status() {
  Status status;
  status.vehicle = config_.vehicle;
  status.running = true;
  status.version = version;
  for (const auto& watch : watches_) status.pairs.push_back(status_of(*watch));
  status.feed_queued = ledger_.waiting_alert_count();
  status.records_missing = ledger_.records_missing();
  const std::lock_guard lock(mutex_);
  status_ = std::move(status);
  status_collected_ = std::chrono::steady_clock::now();
  ++collections_;
}

Status Service::status() const {
  const std::lock_guard lock(mutex_);
  Status status = status_;
  const auto time = std::chrono::steady_clock::now();
  status.uptime_s = std::chrono::duration<double>(time - started_).count();
  const double since_s = std::chrono::duration<double>(time - status_collected_).count();
  const auto grow_older = [since_s](PairStatus::Input& input) {
    if (input.age_s) *input.age_s += since_s;
  };
  for (PairStatus& pair : status.pairs) {
    grow_older(pair.image);
    grow_older(pair.cloud);
    if (pair.right_image) grow_older(*pair.right_image);
    if (pair.depth) grow_older(*pair.depth);
    if (pair.motion) grow_older(*pair.motion);
  }
  expire(status, {ledger_.provenance().boot_id, now().since_boot});
  return status;
}

/// By a connection of its own: the ledger's belongs to the other thread.
json Service::records(const json& from) const {
  constexpr std::size_t most_bytes = 1 << 20;
  if (!from.is_number_unsigned() || from == 0U) return refusal("bad_request", "\"from\" is a record's number");
  const auto store = Store::open(config_.state_dir / "calibd.db", Store::Mode::read_only);
  const auto stored = store.and_then([](const Store& opened) { return opened.record_count(); });
  if (!stored) return refusal("failed", stored.error().context);
  json reply{{"ok", true}, {"stored", *stored}, {"records", json::array()}};
  std::size_t bytes = 0;
  for (auto sequence = from.get<std::uint64_t>(); sequence <= *stored && bytes < most_bytes; ++sequence) {
    const auto record = store->record(sequence);
    if (!record && record.error().code != ErrorCode::record_not_found) return refusal("failed", record.error().context);
    bytes += record ? record->canonical.size() + record->signature.size() : 0;
    reply["records"].push_back(
        {{"canonical", record ? record->canonical : ""}, {"signature", record ? record->signature : ""}});
  }
  return reply;
}

std::optional<std::string> Service::show() {
  const auto collections = [this] {
    const std::lock_guard lock(mutex_);
    return collections_;
  }();
  const Status status = this->status();
  publish_diagnostics(status);
  std::string verdicts;
  for (const PairStatus& pair : status.pairs)
    verdicts += (verdicts.empty() ? "" : "; ") + pair.name + ": " + std::string(to_string(pair.verdict)) + " (" +
                pair.reason + ')';
  const bool others = verdicts != verdicts_shown_;
  if (others || collections != collection_shown_) {
    const auto written = write_snapshot(config_.runtime_dir / "status.json", status);
    if (!written && failures_logged_.insert(written.error().code).second)
      journal(4, message_ids::snapshot_failed,
              written.error().context + "; status is still answered on the control socket");
    collection_shown_ = collections;
  }
  if (!others) return std::nullopt;
  verdicts_shown_ = verdicts;
  return verdicts;
}

void Service::publish_diagnostics(const Status& status) {
  const auto time = std::chrono::steady_clock::now();
  if (time < next_diagnostics_) return;
  next_diagnostics_ = time + std::chrono::seconds(1);
  const auto sent = bus_.publish_diagnostics(status, now().wall);
  if (!sent && failures_logged_.insert(sent.error().code).second)
    journal(4, message_ids::bus_failed, sent.error().context + "; diagnostics are tried again every second");
}

/// All extrinsics that were computed: proposed ones, and those in force that are not the configuration's. Late readers
/// get the last message only, so it holds them all.
void Service::publish_extrinsics() {
  std::vector<ProposedExtrinsic> extrinsics;
  for (const auto& watch : watches_) {
    const PairConfig& pair = *watch->config;
    if (const auto T = watch->pair->computed_extrinsic())
      extrinsics.push_back({pair.camera.frame_id, pair.lidar.frame_id, *T});
  }
  if (extrinsics.empty()) return;
  if (const auto sent = bus_.publish_proposed(extrinsics, now().wall); !sent)
    journal(4, message_ids::bus_failed,
            sent.error().context + "; the extrinsic is in `calibctl status` and the records");
}

}  // namespace calib
