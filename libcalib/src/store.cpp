#include "calib/store.hpp"

#include <fcntl.h>
#include <sqlite3.h>
#include <sys/stat.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstring>

namespace calib {
namespace {

constexpr int schema_version = 1;
constexpr int reader_patience_ms = 5000, writer_patience_ms = 250;
constexpr std::array<const char*, 4> file_endings{"", "-wal", "-shm", "-journal"};

// AUTOINCREMENT keeps the highest alert sequence ever given, also when the outbox is empty again.
constexpr const char* schema = R"sql(
  CREATE TABLE record(
    sequence INTEGER PRIMARY KEY,
    pair TEXT NOT NULL,
    canonical TEXT NOT NULL,
    signature TEXT NOT NULL) STRICT;
  CREATE TABLE state(pair TEXT PRIMARY KEY, json TEXT NOT NULL) STRICT;
  CREATE TABLE outbox(sequence INTEGER PRIMARY KEY AUTOINCREMENT, json TEXT NOT NULL) STRICT;
  PRAGMA user_version = 1;
)sql";

Error store_error(sqlite3* database) {
  const char* const name = database ? sqlite3_db_filename(database, "main") : nullptr;
  return {ErrorCode::store_failed, std::string(name ? name : "the store") + ": " + sqlite3_errmsg(database)};
}

Result<void> run(sqlite3* database, const char* sql) {
  if (sqlite3_exec(database, sql, nullptr, nullptr, nullptr) != SQLITE_OK) return tl::unexpected(store_error(database));
  return {};
}

/// A prepared statement; parameters are bound in the order of the `bind` calls. Bound text must outlive it.
class Statement {
 public:
  Statement(sqlite3* database, std::string_view sql) : database_(database) {
    sqlite3_prepare_v2(database, sql.data(), static_cast<int>(sql.size()), &statement_, nullptr);
  }
  Statement(const Statement&) = delete;
  Statement& operator=(const Statement&) = delete;
  ~Statement() { sqlite3_finalize(statement_); }

  Statement& bind(std::uint64_t value) {
    sqlite3_bind_int64(statement_, ++bound_, static_cast<sqlite3_int64>(value));
    return *this;
  }
  Statement& bind(std::string_view text) {
    // A null pointer would bind NULL; an empty text is text.
    sqlite3_bind_text64(statement_, ++bound_, text.data() ? text.data() : "", text.size(), SQLITE_STATIC, SQLITE_UTF8);
    return *this;
  }
  /// True when there is a row to read.
  [[nodiscard]] Result<bool> step() {
    const int code = statement_ ? sqlite3_step(statement_) : SQLITE_ERROR;
    if (code == SQLITE_ROW) return true;
    if (code == SQLITE_DONE) return false;
    return tl::unexpected(store_error(database_));
  }
  /// For statements without rows.
  [[nodiscard]] Result<void> execute() {
    return step().map([](bool) {});
  }
  [[nodiscard]] std::uint64_t number(int column) const {
    return static_cast<std::uint64_t>(sqlite3_column_int64(statement_, column));
  }
  [[nodiscard]] std::string text(int column) const {
    const auto* const bytes = reinterpret_cast<const char*>(sqlite3_column_text(statement_, column));
    return bytes ? std::string(bytes, static_cast<std::size_t>(sqlite3_column_bytes(statement_, column))) : "";
  }

 private:
  sqlite3* database_;
  sqlite3_stmt* statement_ = nullptr;
  int bound_ = 0;
};

/// The number in the only row and column of `sql`; NULL counts as 0.
Result<std::uint64_t> single_number(sqlite3* database, const char* sql) {
  Statement query(database, sql);
  const auto row = query.step();
  if (!row) return propagate(row);
  return *row ? query.number(0) : 0;
}

Result<void> prepare_for_writing(sqlite3* database) {
  // FULL: in WAL mode, NORMAL may lose the last commits when the power fails.
  if (const auto set = run(database, "PRAGMA journal_mode = WAL; PRAGMA synchronous = FULL"); !set) return set;
  // A reader without write permission cannot make the log files anew, so they outlive the writer; but empty,
  // or they would be taken for the log of another file that is put in this one's place while nobody writes.
  if (const auto set = run(database, "PRAGMA journal_size_limit = 0"); !set) return set;
  int persist = 1;
  sqlite3_file_control(database, "main", SQLITE_FCNTL_PERSIST_WAL, &persist);
  return {};
}

/// Everything that a schema defines, in its own words.
Result<std::string> schema_of(sqlite3* database) {
  Statement query(database, "SELECT type, name, tbl_name, sql FROM sqlite_master ORDER BY type, name");
  std::string all;
  for (;;) {
    const auto row = query.step();
    if (!row) return propagate(row);
    if (!*row) return all;
    for (int column = 0; column < 4; ++column) all += query.text(column) + '\n';
  }
}

/// A view or a virtual table in the place of a table could have no end; a trigger could do anything.
Result<void> require_own_schema(sqlite3* database, const std::filesystem::path& file) {
  sqlite3* memory = nullptr;
  const int opened = sqlite3_open(":memory:", &memory);
  const std::unique_ptr<sqlite3, int (*)(sqlite3*)> own(memory, sqlite3_close_v2);
  if (opened != SQLITE_OK) return tl::unexpected(store_error(memory));
  if (auto made = run(memory, schema); !made) return made;
  const auto expected = schema_of(memory), found = schema_of(database);
  if (!expected) return propagate(expected);
  if (!found) return propagate(found);
  if (*found != *expected)
    return fail(ErrorCode::store_failed, file.string() + " has other tables than a store of calibd; move it away");
  return {};
}

/// SQLite would wait for ever for a FIFO in the place of one of its files.
Result<void> require_regular_files(const std::filesystem::path& file) {
  for (const char* ending : file_endings) {
    std::error_code error;
    const auto status = std::filesystem::status(file.string() + ending, error);
    if (std::filesystem::exists(status) && !std::filesystem::is_regular_file(status))
      return fail(ErrorCode::store_failed, file.string() + ending + " is no regular file");
  }
  return {};
}

/// Makes the file for its owner alone, or takes it back from others: SQLite gives its log files the same rights.
Result<void> keep_for_owner(const std::filesystem::path& file) {
  const int made = ::open(file.c_str(), O_RDWR | O_CREAT | O_CLOEXEC | O_NONBLOCK, 0600);
  if (made < 0) return fail(ErrorCode::store_failed, file.string() + ": " + std::strerror(errno));
  ::close(made);
  for (const char* ending : file_endings)
    if (::chmod((file.string() + ending).c_str(), 0600) != 0 && errno != ENOENT)
      return fail(ErrorCode::store_failed, file.string() + ending + ": " + std::strerror(errno));
  return {};
}

std::uint64_t inode_of(const std::string& file) {
  struct stat about {};
  return ::stat(file.c_str(), &about) == 0 ? about.st_ino : 0;
}

Result<std::vector<Store::Alert>> alerts_of(Statement& query) {
  std::vector<Store::Alert> alerts;
  for (;;) {
    const auto row = query.step();
    if (!row) return propagate(row);
    if (!*row) return alerts;
    alerts.push_back({query.number(0), query.text(1)});
  }
}

/// Alerts leave the outbox oldest first: those that wait are consecutive and need no counting one by one.
constexpr const char* count_waiting =
    "SELECT (SELECT max(sequence) FROM outbox) - (SELECT min(sequence) FROM outbox) + 1";

}  // namespace

void Store::Close::operator()(sqlite3* database) const { sqlite3_close_v2(database); }

Result<Store> Store::open(const std::filesystem::path& file, Mode mode) {
  std::error_code ignored;
  if (mode == Mode::read_only && !std::filesystem::exists(file, ignored))
    return fail(ErrorCode::store_not_found, file.string() + " does not exist or may not be looked up; has calibd run?");

  if (auto regular = require_regular_files(file); !regular) return propagate(regular);
  if (mode == Mode::read_write)
    if (auto kept = keep_for_owner(file); !kept) return propagate(kept);
  sqlite3* opened = nullptr;
  const int access = mode == Mode::read_only ? SQLITE_OPEN_READONLY : SQLITE_OPEN_READWRITE | SQLITE_OPEN_CREATE;
  const int code = sqlite3_open_v2(file.c_str(), &opened, access, nullptr);
  Store store;
  store.database_.reset(opened);
  if (code != SQLITE_OK) return tl::unexpected(store_error(opened));
  sqlite3_busy_timeout(opened, mode == Mode::read_only ? reader_patience_ms : writer_patience_ms);

  // A file's own schema may not call functions behind the back of a program that runs as root.
  if (const auto set = run(opened, "PRAGMA trusted_schema = OFF"); !set) return propagate(set);
  if (mode == Mode::read_write)
    if (const auto ready = prepare_for_writing(opened); !ready) return propagate(ready);

  const auto make_schema = [&]() -> Result<void> {
    const auto version = single_number(opened, "PRAGMA user_version");
    if (!version) return propagate(version);
    if (*version == 0 && mode == Mode::read_write) return run(opened, schema);
    if (*version == 0)
      return fail(ErrorCode::store_not_found, file.string() + " is empty: calibd has not started with it");
    if (*version != schema_version)
      return fail(ErrorCode::store_version, file.string() + " has schema version " + std::to_string(*version) +
                                                ", this program knows " + std::to_string(schema_version) +
                                                "; use the calibd that wrote it or a newer one");
    return require_own_schema(opened, file);
  };
  const Result<void> ready = mode == Mode::read_write ? store.in_transaction(make_schema) : make_schema();
  if (!ready) return propagate(ready);
  store.log_inode_ = inode_of(file.string() + "-wal");
  return store;
}

Result<void> Store::still_there() const {
  int moved = 0;
  sqlite3_file_control(database_.get(), "main", SQLITE_FCNTL_HAS_MOVED, &moved);
  const std::string file = sqlite3_db_filename(database_.get(), "main");
  if (moved != 0 || (log_inode_ != 0 && inode_of(file + "-wal") != log_inode_))
    return fail(ErrorCode::store_moved,
                file + " was removed or replaced while it was in use; calibd must be started again");
  return {};
}

Result<void> Store::in_transaction(const std::function<Result<void>()>& body) {
  if (const auto begun = run(database_.get(), "BEGIN IMMEDIATE"); !begun) return begun;
  const auto roll_back = [this] { sqlite3_exec(database_.get(), "ROLLBACK", nullptr, nullptr, nullptr); };
  Result<void> done;
  try {
    done = body();
  } catch (...) {
    roll_back();
    throw;
  }
  if (done && log_inode_ != 0) done = still_there();
  if (done) done = run(database_.get(), "COMMIT");
  if (!done) roll_back();
  return done;
}

Result<void> Store::append_record(std::uint64_t sequence, std::string_view pair, const SignedRecord& record) {
  Statement insert(database_.get(),
                   "INSERT INTO record SELECT ?1, ?2, ?3, ?4 "
                   "WHERE ?1 = (SELECT coalesce(max(sequence), 0) + 1 FROM record)");
  const auto done = insert.bind(sequence).bind(pair).bind(record.canonical).bind(record.signature).execute();
  if (done && sqlite3_changes(database_.get()) == 0)
    return fail(ErrorCode::broken_chain,
                "record " + std::to_string(sequence) + " does not follow the last one of the store");
  return done;
}

Result<std::uint64_t> Store::record_count() const {
  return single_number(database_.get(), "SELECT max(sequence) FROM record");
}

Result<SignedRecord> Store::record(std::uint64_t sequence) const {
  Statement query(database_.get(), "SELECT canonical, signature FROM record WHERE sequence = ?");
  const auto row = query.bind(sequence).step();
  if (!row) return propagate(row);
  if (!*row) return fail(ErrorCode::record_not_found, "the store holds no record " + std::to_string(sequence));
  return SignedRecord{query.text(0), query.text(1)};
}

Result<void> Store::save_state(std::string_view pair, std::string_view json) {
  Statement upsert(database_.get(),
                   "INSERT INTO state VALUES(?1, ?2) ON CONFLICT(pair) DO UPDATE SET json = excluded.json");
  return upsert.bind(pair).bind(json).execute();
}

Result<std::optional<std::string>> Store::state(std::string_view pair) const {
  Statement query(database_.get(), "SELECT json FROM state WHERE pair = ?");
  const auto row = query.bind(pair).step();
  if (!row) return propagate(row);
  return *row ? std::optional(query.text(0)) : std::nullopt;
}

Result<std::uint64_t> Store::next_alert_sequence() const {
  return single_number(database_.get(), "SELECT seq FROM sqlite_sequence WHERE name = 'outbox'")
      .map([](std::uint64_t last) { return last + 1; });
}

Result<std::uint64_t> Store::enqueue_alert(std::string_view json) {
  const auto waiting = waiting_alert_count();
  if (!waiting) return waiting;
  if (*waiting >= max_waiting_alerts) {
    Statement make_room(database_.get(), "DELETE FROM outbox WHERE sequence = (SELECT min(sequence) FROM outbox)");
    if (const auto made = make_room.execute(); !made) return propagate(made);
  }
  Statement insert(database_.get(), "INSERT INTO outbox(json) VALUES(?)");
  const auto done = insert.bind(json).execute();
  if (!done) return propagate(done);
  return static_cast<std::uint64_t>(sqlite3_last_insert_rowid(database_.get()));
}

Result<std::vector<Store::Alert>> Store::waiting_alerts(std::size_t limit) const {
  Statement query(database_.get(), "SELECT sequence, json FROM outbox ORDER BY sequence LIMIT ?");
  return alerts_of(query.bind(std::uint64_t{limit}));
}

Result<std::vector<Store::Alert>> Store::latest_alerts(std::size_t limit) const {
  Statement query(database_.get(),
                  "SELECT * FROM (SELECT sequence, json FROM outbox ORDER BY sequence DESC LIMIT ?) ORDER BY sequence");
  return alerts_of(query.bind(std::uint64_t{limit}));
}

Result<std::uint64_t> Store::waiting_alert_count() const { return single_number(database_.get(), count_waiting); }

Result<void> Store::alerts_delivered(std::uint64_t sequence) {
  Statement erase(database_.get(), "DELETE FROM outbox WHERE sequence <= ?");
  return erase.bind(sequence).execute();
}

Result<std::vector<CalibrationRecord>> verified_history(const Store& store, const PublicKey& key) {
  const auto count = store.record_count();
  if (!count) return propagate(count);
  std::vector<CalibrationRecord> records;
  const auto all = visit_verified(
      *count, [&](std::uint64_t sequence) { return store.record(sequence); }, key,
      [&](const CalibrationRecord& record, const SignedRecord&) { records.push_back(record); });
  if (!all) return propagate(all);
  return records;
}

}  // namespace calib
