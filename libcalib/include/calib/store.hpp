#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "calib/chain.hpp"

struct sqlite3;

namespace calib {

/// What survives a restart, in one SQLite file (WAL, synchronous=FULL): signed records, the state of every
/// pair's drift monitor, and the outbox of alerts that wait for delivery. One writer (the daemon), any number
/// of readers.
///
/// Every write is durable when the call returns; writes that belong together go through `in_transaction`.
/// All calls fail with `store_failed` (SQLite's own words in the context). A Store is used by one thread at a
/// time; threads and processes that read open their own. Reading needs no permission to write, and no running
/// daemon: the log files that SQLite needs for that stay beside the file after it is closed.
class Store {
 public:
  enum class Mode { read_only, read_write };
  /// Opens `file`, making it when `read_write`. Fails with `store_not_found` or `store_failed`; a file of a
  /// newer schema is refused with `store_version`. A writer takes the file from everybody else (mode 0600): whoever
  /// may read it may lock it, and so stop the writer.
  [[nodiscard]] static Result<Store> open(const std::filesystem::path& file, Mode mode);

  /// Runs `body` in one transaction: all of its writes become durable together, or none when it fails. Not
  /// nested. Waits no longer than a quarter of a second for another program's lock. Fails with `store_moved` when the
  /// file was removed or replaced since it was opened: what is written then is lost with this process.
  [[nodiscard]] Result<void> in_transaction(const std::function<Result<void>()>& body);

  /// Appends a record. Fails with `broken_chain` when `sequence` is not the last one plus 1.
  [[nodiscard]] Result<void> append_record(std::uint64_t sequence, std::string_view pair, const SignedRecord& record);
  /// The sequence of the last record, 0 when there is none.
  [[nodiscard]] Result<std::uint64_t> record_count() const;
  /// Fails with `record_not_found`.
  [[nodiscard]] Result<SignedRecord> record(std::uint64_t sequence) const;

  /// State of a pair as an opaque JSON text; none when never saved.
  [[nodiscard]] Result<void> save_state(std::string_view pair, std::string_view json);
  [[nodiscard]] Result<std::optional<std::string>> state(std::string_view pair) const;

  /// An alert that waits for delivery. `sequence` rises by one per alert, for ever, across restarts.
  struct Alert {
    std::uint64_t sequence = 0;
    std::string json;
  };
  /// The sequence the next `enqueue_alert` will give.
  [[nodiscard]] Result<std::uint64_t> next_alert_sequence() const;
  /// When `max_waiting_alerts` wait, the oldest makes room: an outbox that nobody empties stops nothing else. The gap
  /// shows in the numbers.
  [[nodiscard]] Result<std::uint64_t> enqueue_alert(std::string_view json);
  static constexpr std::uint64_t max_waiting_alerts = 100'000;
  /// Up to `limit` waiting alerts, oldest first.
  [[nodiscard]] Result<std::vector<Alert>> waiting_alerts(std::size_t limit) const;
  /// The last `limit` of them, oldest first.
  [[nodiscard]] Result<std::vector<Alert>> latest_alerts(std::size_t limit) const;
  [[nodiscard]] Result<std::uint64_t> waiting_alert_count() const;
  /// Forgets alerts up to and including `sequence`: they were delivered.
  [[nodiscard]] Result<void> alerts_delivered(std::uint64_t sequence);

 private:
  struct Close {
    void operator()(sqlite3* database) const;
  };
  [[nodiscard]] Result<void> still_there() const;
  std::unique_ptr<sqlite3, Close> database_;
  std::uint64_t log_inode_ = 0;  // of the write-ahead log
};

/// The verified records of a store as a list, as `visit_verified`, or the failure alone.
[[nodiscard]] Result<std::vector<CalibrationRecord>> verified_history(const Store& store, const PublicKey& key);

}  // namespace calib
