#include "calib/store.hpp"
#include "sqlite_statement.hpp"

namespace calib {

using sqlite::single_number;
using sqlite::Statement;

namespace {

template <typename Row, typename Read>
Result<std::vector<Row>> rows_of(Statement& query, Read read) {
  std::vector<Row> rows;
  for (;;) {
    const auto row = query.step();
    if (!row) return propagate(row);
    if (!*row) return rows;
    rows.push_back(read());
  }
}

std::uint64_t seconds(WallTime time) {
  return static_cast<std::uint64_t>(std::chrono::floor<std::chrono::seconds>(time).count());
}

}  // namespace

Result<std::uint64_t> Store::next_alert_sequence() const {
  return single_number(database_.get(), "SELECT seq FROM sqlite_sequence WHERE name = 'alert'")
      .map([](std::uint64_t last) { return last + 1; });
}

Result<std::uint64_t> Store::keep_alert(std::string_view json) {
  Statement insert(database_.get(), "INSERT INTO alert(json) VALUES(?)");
  if (const auto done = insert.bind(json).execute(); !done) return propagate(done);
  const auto sequence = static_cast<std::uint64_t>(sqlite3_last_insert_rowid(database_.get()));
  if (sequence <= kept_alerts) return sequence;
  Statement erase(database_.get(), "DELETE FROM alert WHERE sequence <= ?");
  return erase.bind(sequence - kept_alerts).execute().map([&] { return sequence; });
}

Result<std::vector<Store::Alert>> Store::latest_alerts(std::size_t limit) const {
  Statement query(database_.get(),
                  "SELECT * FROM (SELECT sequence, json FROM alert ORDER BY sequence DESC LIMIT ?) ORDER BY sequence");
  query.bind(std::uint64_t{limit});
  return rows_of<Alert>(query, [&] { return Alert{query.number(0), query.text(1)}; });
}

Result<std::uint64_t> Store::next_event_sequence() const {
  return single_number(database_.get(), "SELECT seq FROM sqlite_sequence WHERE name = 'outbox'")
      .map([](std::uint64_t last) { return last + 1; });
}

Result<void> Store::enqueue_event(const Event& event) {
  Statement insert(database_.get(),
                   "INSERT INTO outbox SELECT ?1, ?2, ?3, ?4 "
                   "WHERE ?1 = coalesce((SELECT seq FROM sqlite_sequence WHERE name = 'outbox'), 0) + 1");
  const auto done = insert.bind(event.sequence)
                        .bind(std::uint64_t{static_cast<std::uint8_t>(event.priority)})
                        .bind(seconds(event.expires))
                        .bind(event.json)
                        .execute();
  if (done && sqlite3_changes(database_.get()) == 0)
    return fail(ErrorCode::store_failed, "event " + std::to_string(event.sequence) + " is not the next one");
  return done;
}

Result<void> Store::replace_event(const Event& event) {
  Statement update(database_.get(), "UPDATE outbox SET priority = ?2, expires = ?3, json = ?4 WHERE sequence = ?1");
  return update.bind(event.sequence)
      .bind(std::uint64_t{static_cast<std::uint8_t>(event.priority)})
      .bind(seconds(event.expires))
      .bind(event.json)
      .execute();
}

Result<std::vector<Store::Event>> Store::waiting_events(std::uint64_t after, std::size_t limit) const {
  Statement query(database_.get(),
                  "SELECT sequence, priority, expires, json FROM outbox WHERE sequence > ? ORDER BY sequence LIMIT ?");
  query.bind(after).bind(std::uint64_t{limit});
  return rows_of<Event>(query, [&] {
    return Event{query.number(0), static_cast<Priority>(query.number(1)),
                 std::chrono::seconds(static_cast<std::int64_t>(query.number(2))), query.text(3)};
  });
}

Result<std::uint64_t> Store::waiting_event_count() const {
  return single_number(database_.get(), "SELECT count(*) FROM outbox");
}

Result<void> Store::acknowledge(std::uint64_t sequence) {
  Statement erase(database_.get(), "DELETE FROM outbox WHERE sequence <= ?");
  return erase.bind(sequence).execute();
}

Result<void> Store::forget_states() {
  Statement erase(database_.get(), "DELETE FROM outbox WHERE priority = ?");
  return erase.bind(std::uint64_t{static_cast<std::uint8_t>(Priority::state)}).execute();
}

Result<void> Store::save_feed_memory(std::string_view text) {
  Statement upsert(database_.get(),
                   "INSERT INTO feed VALUES(1, ?) ON CONFLICT(only) DO UPDATE SET json = excluded.json");
  return upsert.bind(text).execute();
}

Result<std::optional<std::string>> Store::feed_memory() const {
  Statement query(database_.get(), "SELECT json FROM feed");
  const auto row = query.step();
  if (!row) return propagate(row);
  return *row ? std::optional(query.text(0)) : std::nullopt;
}

}  // namespace calib
