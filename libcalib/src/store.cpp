#include "calib/store.hpp"

#include <fcntl.h>
#include <sqlite3.h>
#include <sys/stat.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstring>

#include "sqlite_statement.hpp"

namespace calib {
namespace {

using sqlite::run;
using sqlite::single_number;
using sqlite::Statement;
using sqlite::store_error;

constexpr std::uint64_t schema_version = 2;
constexpr int reader_patience_ms = 5000, writer_patience_ms = 250;
constexpr std::array<const char*, 4> file_endings{"", "-wal", "-shm", "-journal"};

constexpr std::string_view record_tables = R"sql(
  CREATE TABLE record(
    sequence INTEGER PRIMARY KEY,
    pair TEXT NOT NULL,
    canonical TEXT NOT NULL,
    signature TEXT NOT NULL) STRICT;
  CREATE TABLE state(pair TEXT PRIMARY KEY, json TEXT NOT NULL) STRICT;
)sql";
// AUTOINCREMENT keeps the highest sequence ever given, also when the table is empty again.
constexpr std::string_view feed_tables = R"sql(
  CREATE TABLE alert(sequence INTEGER PRIMARY KEY AUTOINCREMENT, json TEXT NOT NULL) STRICT;
  CREATE TABLE outbox(
    sequence INTEGER PRIMARY KEY AUTOINCREMENT,
    priority INTEGER NOT NULL,
    expires INTEGER NOT NULL,
    json TEXT NOT NULL) STRICT;
  CREATE TABLE feed(only INTEGER PRIMARY KEY CHECK(only = 1), json TEXT NOT NULL) STRICT;
  PRAGMA user_version = 2;
)sql";

// Alerts were in the outbox, for DDS and for whoever would come to empty it.
constexpr std::string_view feed_tables_1 =
    "CREATE TABLE outbox(sequence INTEGER PRIMARY KEY AUTOINCREMENT, json TEXT NOT NULL) STRICT;";
constexpr std::string_view save_feed_1 = R"sql(
  CREATE TEMP TABLE earlier AS SELECT sequence, json FROM outbox;
  CREATE TEMP TABLE given AS SELECT seq FROM sqlite_sequence WHERE name = 'outbox';
  DROP TABLE outbox;
)sql";
// Both counters go on where the one counter was.
constexpr std::string_view restore_feed_1 = R"sql(
  INSERT INTO alert SELECT sequence, json FROM earlier ORDER BY sequence;
  DELETE FROM alert WHERE sequence <= (SELECT max(sequence) FROM alert) - 32;
  INSERT INTO outbox SELECT sequence, 0, 0, json FROM earlier ORDER BY sequence;
  DELETE FROM outbox WHERE sequence <= (SELECT max(sequence) FROM outbox) - 4800;
  DELETE FROM sqlite_sequence WHERE name IN ('alert', 'outbox');
  INSERT INTO sqlite_sequence SELECT 'alert', seq FROM given;
  INSERT INTO sqlite_sequence SELECT 'outbox', seq FROM given;
  DROP TABLE temp.earlier;
  DROP TABLE temp.given;
)sql";
static_assert(Store::kept_alerts == 32 && Store::max_waiting_events == 4800);

std::string joined(std::initializer_list<std::string_view> statements) {
  std::string sql;
  for (const std::string_view statement : statements) sql += statement;
  return sql;
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
Result<void> require_own_schema(sqlite3* database, std::uint64_t version, const std::filesystem::path& file) {
  sqlite3* memory = nullptr;
  const int opened = sqlite3_open(":memory:", &memory);
  const std::unique_ptr<sqlite3, int (*)(sqlite3*)> own(memory, sqlite3_close_v2);
  if (opened != SQLITE_OK) return tl::unexpected(store_error(memory));
  if (auto made = run(memory, joined({record_tables, version == 1 ? feed_tables_1 : feed_tables}).c_str()); !made)
    return made;
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
    if (*version == 0 && mode == Mode::read_write) return run(opened, joined({record_tables, feed_tables}).c_str());
    if (*version == 0)
      return fail(ErrorCode::store_not_found, file.string() + " is empty: calibd has not started with it");
    if (*version > schema_version)
      return fail(ErrorCode::store_version, file.string() + " has schema version " + std::to_string(*version) +
                                                ", this program knows " + std::to_string(schema_version) +
                                                "; use the calibd that wrote it or a newer one");
    // What does not write reads the records of an earlier store as they are.
    if (auto own = require_own_schema(opened, *version, file); !own) return own;
    if (*version == schema_version || mode == Mode::read_only) return {};
    return run(opened, joined({save_feed_1, feed_tables, restore_feed_1}).c_str());
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
