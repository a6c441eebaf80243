#pragma once

#include <sqlite3.h>

#include <cstdint>
#include <string>
#include <string_view>

#include "calib/result.hpp"

// How `Store` speaks to SQLite. Private to its sources.
namespace calib::sqlite {

inline Error store_error(sqlite3* database) {
  const char* const name = database ? sqlite3_db_filename(database, "main") : nullptr;
  return {ErrorCode::store_failed, std::string(name ? name : "the store") + ": " + sqlite3_errmsg(database)};
}

inline Result<void> run(sqlite3* database, const char* sql) {
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
inline Result<std::uint64_t> single_number(sqlite3* database, const char* sql) {
  Statement query(database, sql);
  const auto row = query.step();
  if (!row) return propagate(row);
  return *row ? query.number(0) : 0;
}

}  // namespace calib::sqlite
