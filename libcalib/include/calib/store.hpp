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
/// pair's drift monitor, the latest alerts, and the outbox of events that wait for delivery. One writer (the daemon),
/// any number of readers.
///
/// Every write is durable when the call returns; writes that belong together go through `in_transaction`.
/// All calls fail with `store_failed` (SQLite's own words in the context). A Store is used by one thread at a
/// time; threads and processes that read open their own. Reading needs no permission to write, and no running
/// daemon: the log files that SQLite needs for that stay beside the file after it is closed.
class Store {
 public:
  enum class Mode { read_only, read_write };
  /// Opens `file`, making it when `read_write`. Fails with `store_not_found` or `store_failed`; a file of a
  /// newer schema is refused with `store_version`, one of an older schema is brought to the present one. A writer takes
  /// the file from everybody else (mode 0600): whoever may read it may lock it, and so stop the writer.
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

  /// A change of verdict as DDS has it. `sequence` rises by one per alert, for ever, across restarts.
  struct Alert {
    std::uint64_t sequence = 0;
    std::string json;
  };
  /// The sequence the next `keep_alert` will give.
  [[nodiscard]] Result<std::uint64_t> next_alert_sequence() const;
  /// The latest `kept_alerts` stay, for late readers.
  [[nodiscard]] Result<std::uint64_t> keep_alert(std::string_view json);
  static constexpr std::uint64_t kept_alerts = 32;
  /// The last `limit` of them, oldest first.
  [[nodiscard]] Result<std::vector<Alert>> latest_alerts(std::size_t limit) const;

  /// What the fleet is told, until it was received. `sequence` rises by one per event, for ever, across restarts.
  enum class Priority : std::uint8_t {
    unsent_alert = 0,  // of a store of schema 1: the text of an alert, not of an event
    state = 1,         // a later one makes it superfluous
    alert = 2,
    gap = 3,  // says which others were lost
  };
  struct Event {
    std::uint64_t sequence = 0;
    Priority priority = Priority::alert;
    WallTime expires{};  // when it is no longer of use; in whole seconds
    std::string json;
  };
  [[nodiscard]] Result<std::uint64_t> next_event_sequence() const;
  /// `event.sequence` is the next one: the text names it, too. Fails with `store_failed` otherwise.
  [[nodiscard]] Result<void> enqueue_event(const Event& event);
  /// Puts the event into the place of the row with its sequence.
  [[nodiscard]] Result<void> replace_event(const Event& event);
  /// Up to `limit` waiting events with a sequence above `after`, oldest first.
  [[nodiscard]] Result<std::vector<Event>> waiting_events(std::uint64_t after, std::size_t limit) const;
  [[nodiscard]] Result<std::uint64_t> waiting_event_count() const;
  /// Forgets events up to and including `sequence`: they were received, or make room for others.
  [[nodiscard]] Result<void> acknowledge(std::uint64_t sequence);
  [[nodiscard]] Result<void> forget_states();
  /// Rows are no longer than this, so that two fit into one of SQLite's pages: 4800 take 9.8 MB.
  static constexpr std::size_t max_event_bytes = 2000;
  static constexpr std::uint64_t max_waiting_events = 4800;

  /// What whoever writes events must not forget, as an opaque text; none when never saved.
  [[nodiscard]] Result<void> save_feed_memory(std::string_view text);
  [[nodiscard]] Result<std::optional<std::string>> feed_memory() const;

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
