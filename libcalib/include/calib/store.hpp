#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "calib/record.hpp"

struct sqlite3;

namespace calib {

/// What survives a restart, in one SQLite file (WAL, synchronous=FULL): signed records, the state of every pair's drift
/// monitor, and the outbox of alerts that wait for delivery. One writer (the daemon), any number of readers.
///
/// Every write is durable when the call returns; writes that belong together go through `in_transaction`.
/// All calls fail with `store_failed` (SQLite's own words in the context).
class Store {
 public:
  enum class Mode { read_only, read_write };
  /// Opens `file`, making it when `read_write`. Fails with `store_not_found` or `store_failed`; a file of a newer
  /// schema is refused with `store_version`.
  [[nodiscard]] static Result<Store> open(const std::filesystem::path& file, Mode mode);

  /// Runs `body` in one transaction: all of its writes become durable together, or none when it fails.
  [[nodiscard]] Result<void> in_transaction(const std::function<Result<void>()>& body);

  /// Appends a record; its sequence must be the last one plus 1.
  [[nodiscard]] Result<void> append_record(std::uint64_t sequence, std::string_view pair, const SignedRecord& record);
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
  [[nodiscard]] Result<std::uint64_t> enqueue_alert(std::string_view json);
  /// Up to `limit` waiting alerts, oldest first.
  [[nodiscard]] Result<std::vector<Alert>> waiting_alerts(std::size_t limit) const;
  [[nodiscard]] Result<std::uint64_t> waiting_alert_count() const;
  /// Forgets alerts up to and including `sequence`: they were delivered.
  [[nodiscard]] Result<void> alerts_delivered(std::uint64_t sequence);

 private:
  struct Close {
    void operator()(sqlite3* database) const;
  };
  std::unique_ptr<sqlite3, Close> database_;
};

/// Every record of the store, oldest first, each verified against `key` and its predecessor before it is returned.
/// Fails at the first that does not verify, naming its sequence.
[[nodiscard]] Result<std::vector<CalibrationRecord>> verified_history(const Store& store, const PublicKey& key);

}  // namespace calib
