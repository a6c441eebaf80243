#pragma once

#include <sqlite3.h>

#include <filesystem>
#include <random>
#include <stdexcept>
#include <string>
#include <vector>

#include "calib/store.hpp"
#include "support/records.hpp"

namespace calib::test {

/// A store in a temporary folder, and what a test does to it.
struct StoreFixture {
  TemporaryFolder folder;
  std::filesystem::path file = folder.path() / "calibd.db";
  SigningKey key = SigningKey::generate();
  std::mt19937 random{1};

  [[nodiscard]] Store open(Store::Mode mode = Store::Mode::read_write) const {
    return require_ok(Store::open(file, mode));
  }
  std::vector<SignedRecord> append_chain(Store& store, std::size_t count) {
    auto chain = random_chain(random, count, key);
    for (std::size_t i = 0; i < chain.size(); ++i) require_ok(store.append_record(i + 1, "front", chain[i]));
    return chain;
  }
  /// SQL as somebody with write access to the file would run it.
  void tamper(const std::string& sql) const {
    sqlite3* database = nullptr;
    if (sqlite3_open(file.c_str(), &database) != SQLITE_OK ||
        sqlite3_exec(database, sql.c_str(), nullptr, nullptr, nullptr) != SQLITE_OK)
      throw std::runtime_error(sql + ": " + sqlite3_errmsg(database));
    sqlite3_close(database);
  }
};

}  // namespace calib::test
