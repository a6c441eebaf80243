#include "calib/store.hpp"
#include "message_ids.hpp"
#include "service.hpp"
#include "snapshot.hpp"
#include "version.hpp"

namespace calib {

PairStatus Service::status_of(const Pair& pair) const {
  const Now time = now(pair);
  PairStatus status = pair.pipeline.status(pair.state, pair.store_failure, time);
  if (const auto proposed = proposal(pair))
    status.proposed = PairStatus::Proposed{proposed->T_camera_lidar, proposed->sequence};
  // Every record was verified when the ledger was opened, or signed by this very process.
  const CalibrationRecord* record = time.history.in_force();
  if (record->sequence > 0)
    status.record = PairStatus::Record{record->sequence, ledger_.key_id(record->sequence), true, record->wall_time};
  const auto input = [&](const std::string& topic, const std::optional<std::chrono::nanoseconds>& arrived) {
    PairStatus::Input shown{topic, std::nullopt};
    if (arrived) shown.age_s = std::chrono::duration<double>(time.time.since_boot - *arrived).count();
    return shown;
  };
  status.remarks = pair.remarks;
  status.image = input(pair.topics.image, pair.image);
  status.cloud = input(pair.topics.cloud, pair.cloud);
  if (pair.topics.right_image) status.right_image = input(*pair.topics.right_image, pair.right_image);
  if (pair.topics.depth) status.depth = input(pair.topics.depth->name, pair.depth_image);
  if (pair.topics.motion) status.motion = input(pair.topics.motion->name, pair.motion);
  if (pair.time_difference)
    status.time_difference_ms = std::chrono::duration<double, std::milli>(*pair.time_difference).count();
  return status;
}

std::optional<CalibrationRecord> Service::proposal(const Pair& pair) const {
  if (!pair.state.proposed_record) return std::nullopt;
  auto found = ledger_.find(pair.config->name, *pair.state.proposed_record);
  return found ? std::optional(std::move(*found)) : std::nullopt;
}

void Service::collect_status() {
  Status status;
  status.vehicle = config_.vehicle;
  status.running = true;
  status.version = version;
  for (const auto& pair : pairs_) status.pairs.push_back(status_of(*pair));
  tell_fleet(status);
  status.feed_queued = ledger_.waiting_event_count();
  status.records_missing = ledger_.records_missing();
  status.signing_refused = ledger_.signing_refused();
  {
    const std::lock_guard lock(mutex_);
    status_ = std::move(status);
    status_collected_ = surroundings_.clock().since_boot;
    ++collections_;
  }
  surroundings_.status_changed();
}

Status Service::status() const {
  const std::lock_guard lock(mutex_);
  Status status = status_;
  const auto time = surroundings_.clock().since_boot;
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
  expire(status, {ledger_.provenance().boot_id, time});
  return status;
}

/// By a connection of its own: the ledger's belongs to the other thread.
Result<RecordsPage> Service::records(std::uint64_t from) const {
  constexpr std::size_t most_bytes = 1 << 20;
  const auto store = Store::open(config_.state_dir / "calibd.db", Store::Mode::read_only);
  const auto stored = store.and_then([](const Store& opened) { return opened.record_count(); });
  if (!stored) return fail(ErrorCode::failed, stored.error().context);
  RecordsPage page{.stored = *stored, .records = {}};
  std::size_t bytes = 0;
  for (auto sequence = from; sequence <= *stored && bytes < most_bytes; ++sequence) {
    auto record = store->record(sequence);
    if (!record && record.error().code != ErrorCode::record_not_found)
      return fail(ErrorCode::failed, record.error().context);
    page.records.push_back(record ? std::move(*record) : SignedRecord{});
    bytes += page.records.back().canonical.size() + page.records.back().signature.size();
  }
  return page;
}

std::optional<std::string> Service::show() {
  const auto collections = [this] {
    const std::lock_guard lock(mutex_);
    return collections_;
  }();
  const Status status = this->status();
  publish_diagnostics(status);
  answer_who_waits_for_events();
  std::string verdicts = status.signing_refused ? "signing is refused: " + *status.signing_refused : "";
  {
    const std::lock_guard lock(mutex_);
    if (!reload_refused_.empty())
      verdicts += (verdicts.empty() ? "" : "; ") + ("the configuration was not reloaded: " + reload_refused_);
  }
  for (const PairStatus& pair : status.pairs)
    verdicts += (verdicts.empty() ? "" : "; ") + pair.name + ": " + std::string(to_string(pair.verdict)) + " (" +
                pair.reason + ')';
  const bool others = verdicts != verdicts_shown_;
  if (others || collections != collection_shown_) {
    const auto written = write_snapshot(config_.runtime_dir / "status.json", status);
    if (!written && failures_logged_.insert(written.error().code).second)
      surroundings_.log(4, message_ids::snapshot_failed,
                        written.error().context + "; status is still answered on the control socket");
    collection_shown_ = collections;
  }
  if (!others) return std::nullopt;
  verdicts_shown_ = verdicts;
  return verdicts;
}

void Service::publish_diagnostics(const Status& status) {
  const Moment time = surroundings_.clock();
  if (time.since_boot < next_diagnostics_) return;
  // One that is late does not delay those after it.
  constexpr std::chrono::seconds period{1};
  const bool on_time = time.since_boot < next_diagnostics_ + period;
  next_diagnostics_ = (on_time ? next_diagnostics_ : time.since_boot) + period;
  const auto sent = network_->publish_diagnostics(status, time.wall);
  if (!sent && failures_logged_.insert(sent.error().code).second)
    surroundings_.log(4, message_ids::bus_failed, sent.error().context + "; diagnostics are tried again every second");
}

/// All extrinsics that were computed: proposed ones, and those in force that are not the configuration's. Late readers
/// get the last message only, so it holds them all.
void Service::publish_extrinsics() {
  std::vector<ProposedExtrinsic> extrinsics;
  for (const auto& pair : pairs_) {
    const CalibrationRecord* in_force = ledger_.history(pair->config->name).in_force();
    const auto proposed = proposal(*pair);
    if (!proposed && in_force->decision == Decision::initial) continue;
    extrinsics.push_back({pair->config->camera.frame_id.or_seen(pair->camera_frame),
                          pair->config->lidar.frame_id.or_seen(pair->lidar_frame),
                          proposed ? proposed->T_camera_lidar : pair->state.T_camera_lidar});
  }
  if (extrinsics.empty()) return;
  if (const auto sent = network_->publish_proposed(extrinsics, surroundings_.clock().wall); !sent)
    surroundings_.log(4, message_ids::bus_failed,
                      sent.error().context + "; the extrinsic is in `calibctl status` and the records");
}

}  // namespace calib
