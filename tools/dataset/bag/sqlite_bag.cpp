#include <sqlite3.h>

#include <algorithm>
#include <map>
#include <mutex>

#include "dataset/bag/bag_storage.hpp"
#include "dataset/bag/decompress.hpp"

namespace calib {
namespace {

template <typename Handle, int (*close)(Handle*)>
struct Close {
  void operator()(Handle* handle) const { close(handle); }
};
using Database = std::unique_ptr<sqlite3, Close<sqlite3, sqlite3_close>>;
using Statement = std::unique_ptr<sqlite3_stmt, Close<sqlite3_stmt, sqlite3_finalize>>;
using Blob = std::unique_ptr<sqlite3_blob, Close<sqlite3_blob, sqlite3_blob_close>>;

std::string text(sqlite3_stmt* row, int column) {
  const auto* bytes = reinterpret_cast<const char*>(sqlite3_column_text(row, column));
  return bytes == nullptr ? std::string() : std::string(bytes, sqlite3_column_bytes(row, column));
}

class SqliteBag : public BagStorage {
 public:
  explicit SqliteBag(std::string name) : name_(std::move(name)) {}

  [[nodiscard]] Result<void> open(const std::filesystem::path& path) {
    // A recorder that was killed leaves a log beside the file, which SQLite reads only when it may make another one.
    std::error_code error;
    const auto log = std::filesystem::file_size(path.string() + "-wal", error);
    const bool has_log = !error && log > 0;
    sqlite3* opened = nullptr;
    const int code =
        sqlite3_open_v2(uri(path, has_log).c_str(), &opened, SQLITE_OPEN_READONLY | SQLITE_OPEN_URI, nullptr);
    database_.reset(opened);
    if (code != SQLITE_OK) return unreadable();
    sqlite3_limit(opened, SQLITE_LIMIT_LENGTH, static_cast<int>(most_bytes));
    sqlite3_limit(opened, SQLITE_LIMIT_ATTACHED, 0);
    sqlite3_db_config(opened, SQLITE_DBCONFIG_TRUSTED_SCHEMA, 0, nullptr);
    // A file that is shorter than it says is refused as a whole otherwise. Nothing can be written: it is open
    // read-only.
    sqlite3_db_config(opened, SQLITE_DBCONFIG_WRITABLE_SCHEMA, 1, nullptr);
    if (const auto tables = check_tables(); !tables) return tables;
    if (const auto topics = list_topics(); !topics) return topics;
    list_messages();
    return {};
  }

  [[nodiscard]] Result<Octets> read(const BagMessage& message) const override {
    const std::scoped_lock lock(mutex_);
    Octets bytes;
    if (!open_blob(static_cast<sqlite3_int64>(message.at))) return unreadable();
    bytes.resize(static_cast<std::size_t>(sqlite3_blob_bytes(blob_.get())));
    if (sqlite3_blob_read(blob_.get(), bytes.data(), static_cast<int>(bytes.size()), 0) != SQLITE_OK)
      return unreadable();
    return plain_message(std::move(bytes), most_bytes, name_);
  }

 private:
  static std::string uri(const std::filesystem::path& path, bool has_log) {
    std::string uri = "file:";
    for (const char c : std::filesystem::absolute(path).string()) {
      constexpr const char* digits = "0123456789abcdef";
      const auto byte = static_cast<std::uint8_t>(c);
      if (c == '?' || c == '#' || c == '%')
        uri += {'%', digits[byte >> 4], digits[byte & 15]};
      else
        uri += c;
    }
    return uri + (has_log ? "?mode=ro" : "?immutable=1");
  }

  [[nodiscard]] tl::unexpected<Error> unreadable() const {
    return fail(ErrorCode::file_unreadable, name_ + " cannot be read: " + sqlite3_errmsg(database_.get()));
  }

  [[nodiscard]] Statement prepare(const char* sql) const {
    sqlite3_stmt* prepared = nullptr;
    sqlite3_prepare_v2(database_.get(), sql, -1, &prepared, nullptr);
    return Statement(prepared);
  }

  /// Views and virtual tables, which may compute for ever, are not what rosbag2 writes.
  [[nodiscard]] Result<void> check_tables() const {
    const Statement count = prepare(
        "SELECT count(*) FROM sqlite_master WHERE type = 'table' AND rootpage > 0 AND name IN ('topics', 'messages')");
    if (!count || sqlite3_step(count.get()) != SQLITE_ROW) return unreadable();
    if (sqlite3_column_int(count.get(), 0) == 2) return {};
    return fail(ErrorCode::file_unreadable, name_ + " has no tables topics and messages: it is not of rosbag2");
  }

  [[nodiscard]] Result<void> list_topics() {
    const Statement rows = prepare("SELECT id, name, type, serialization_format FROM topics");
    if (!rows) return unreadable();
    int code = SQLITE_ROW;
    while ((code = sqlite3_step(rows.get())) == SQLITE_ROW && list().topics.size() < most_topics) {
      BagTopic topic{text(rows.get(), 1), text(rows.get(), 2), text(rows.get(), 3)};
      const auto number = list().add(std::move(topic));
      if (number) numbers_.try_emplace(sqlite3_column_int64(rows.get(), 0), *number);
    }
    if (code == SQLITE_ROW || code == SQLITE_DONE) return {};
    return unreadable();
  }

  void list_messages() {
    // In the order of the file, so that no page is read twice; rosbag2 numbers messages as they come.
    const Statement rows = prepare("SELECT rowid, topic_id FROM messages NOT INDEXED");
    int code = rows ? sqlite3_step(rows.get()) : SQLITE_ERROR;
    for (; code == SQLITE_ROW && list().messages.size() < most_messages; code = sqlite3_step(rows.get())) {
      const auto topic = numbers_.find(sqlite3_column_int64(rows.get(), 1));
      if (topic == numbers_.end()) continue;
      ++list().topics[topic->second].messages;
      if (!list().topics[topic->second].is_listed()) continue;
      const sqlite3_int64 id = sqlite3_column_int64(rows.get(), 0);
      BagMessage message{topic->second, 0, static_cast<std::uint64_t>(id), 0, BagMessage::no_stamp};
      if (list().topics[topic->second].type != bag_type::transforms) message.stamp = stamp_of(id);
      list().messages.push_back(message);
    }
    if (code == SQLITE_ROW)
      list().remarks.push_back("only the first " + std::to_string(most_messages) + " messages of " + name_ +
                               " are read");
    else if (code != SQLITE_DONE)
      list().remarks.push_back(name_ + " ends early or is damaged (" + sqlite3_errmsg(database_.get()) +
                               "): what comes before that is read, which are " +
                               std::to_string(list().messages.size()) + " messages");
  }

  [[nodiscard]] bool open_blob(sqlite3_int64 id) const {
    if (blob_ && sqlite3_blob_reopen(blob_.get(), id) == SQLITE_OK) return true;
    blob_.reset();
    sqlite3_blob* opened = nullptr;
    const int code = sqlite3_blob_open(database_.get(), "main", "messages", "data", id, 0, &opened);
    blob_.reset(opened);
    return code == SQLITE_OK;
  }

  /// Without reading more of a message than its first page.
  [[nodiscard]] Timestamp stamp_of(sqlite3_int64 id) const {
    if (!open_blob(id)) return BagMessage::no_stamp;
    const auto size = static_cast<std::size_t>(sqlite3_blob_bytes(blob_.get()));
    Octets bytes(std::min(size, stamp_bytes));
    const auto fill = [&] {
      return sqlite3_blob_read(blob_.get(), bytes.data(), static_cast<int>(bytes.size()), 0) == SQLITE_OK;
    };
    if (!fill()) return BagMessage::no_stamp;
    if (!is_zstd(bytes)) return stamp_in(bytes);
    bytes.resize(size);
    return fill() ? stamp_in(decompress_zstd(bytes, stamp_bytes).bytes) : BagMessage::no_stamp;
  }

  std::string name_;
  Database database_;
  std::map<sqlite3_int64, std::uint32_t> numbers_;  // of topics
  mutable std::mutex mutex_;
  mutable Blob blob_;
};

}  // namespace

Result<std::unique_ptr<BagStorage>> open_sqlite_bag(const std::filesystem::path& path, const std::string& name) {
  auto bag = std::make_unique<SqliteBag>(name);
  if (const auto opened = bag->open(path); !opened) return propagate(opened);
  return bag;
}

}  // namespace calib
