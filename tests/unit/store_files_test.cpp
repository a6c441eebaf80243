// What lies on the disk: whose it is, whether it is a store of calibd, and whether it is still there.
#include <sys/stat.h>

#include "support/catch.hpp"
#include "support/store_fixture.hpp"

using namespace calib;
using namespace calib::test;
using Catch::Matchers::ContainsSubstring;

TEST_CASE_METHOD(StoreFixture,
                 "a store with other tables than its own is refused, and not read: a view may have no end") {
  { const Store store = open(); }
  tamper(GENERATE(as<const char*>(),
                  "DROP TABLE record; CREATE VIEW record AS WITH RECURSIVE n(sequence) AS (SELECT 1 UNION ALL SELECT "
                  "sequence + 1 FROM n) SELECT sequence, 'front' AS pair, '' AS canonical, '' AS signature FROM n",
                  "CREATE TRIGGER t AFTER INSERT ON state BEGIN DELETE FROM record; END", "CREATE TABLE more(x)",
                  "DROP TABLE outbox"));
  for (const auto mode : {Store::Mode::read_only, Store::Mode::read_write}) {
    const auto opened = Store::open(file, mode);
    REQUIRE_FALSE(opened);
    CHECK(opened.error().code == "store_failed");
    CHECK_THAT(opened.error().context, ContainsSubstring("other tables"));
  }
}

TEST_CASE_METHOD(StoreFixture, "what is written to a file that is no longer there is not called written") {
  Store store = open();
  append_chain(store, 1);
  const auto write = [&] { return store.in_transaction([&] { return store.save_state("front", "new"); }); };
  require_ok(write());
  const char* const ending = GENERATE("", "-wal");
  SECTION("removed") { std::filesystem::remove(file.string() + ending); }
  SECTION("another in its place") {
    std::filesystem::rename(file.string() + ending, folder.path() / "elsewhere");
    std::filesystem::copy(folder.path() / "elsewhere", file.string() + ending);
  }
  const auto lost = write();
  REQUIRE_FALSE(lost);
  CHECK(lost.error().code == "store_moved");
}

TEST_CASE_METHOD(StoreFixture,
                 "the store is its owner's alone, whoever could read it before, and no FIFO is waited for") {
  { const Store store = open(); }
  for (const char* ending : {"", "-wal", "-shm"}) {
    const std::string one = file.string() + ending;
    if (std::filesystem::exists(one)) chmod(one.c_str(), 0666);
  }
  {
    Store store = open();
    append_chain(store, 1);
    for (const char* ending : {"", "-wal", "-shm"}) {
      struct stat about {};
      REQUIRE(stat((file.string() + ending).c_str(), &about) == 0);
      CHECK((about.st_mode & 0777) == 0600);
    }
  }
  const auto fifo = folder.path() / "fifo";
  REQUIRE(mkfifo(fifo.c_str(), 0600) == 0);
  for (const auto mode : {Store::Mode::read_only, Store::Mode::read_write})
    CHECK(Store::open(fifo, mode).error().code == "store_failed");
}
