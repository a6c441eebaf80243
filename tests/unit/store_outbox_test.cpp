// Alerts and events in the store, and a store that an earlier version left.
#include <algorithm>

#include "support/catch.hpp"
#include "support/store_fixture.hpp"

using namespace calib;
using namespace calib::test;

namespace {

Store::Event event(std::uint64_t sequence, Store::Priority priority = Store::Priority::alert,
                   const std::string& json = "{}") {
  return {sequence, priority, std::chrono::hours(1), json};
}

/// The tables of schema 1, as they were written.
constexpr const char* schema_1 = R"sql(
  CREATE TABLE record(
    sequence INTEGER PRIMARY KEY,
    pair TEXT NOT NULL,
    canonical TEXT NOT NULL,
    signature TEXT NOT NULL) STRICT;
  CREATE TABLE state(pair TEXT PRIMARY KEY, json TEXT NOT NULL) STRICT;
  CREATE TABLE outbox(sequence INTEGER PRIMARY KEY AUTOINCREMENT, json TEXT NOT NULL) STRICT;
  PRAGMA user_version = 1;
)sql";

}  // namespace

TEST_CASE_METHOD(StoreFixture, "the number of an event is never used again, also when the outbox is empty") {
  {
    Store store = open();
    for (std::uint64_t expected = 1; expected <= 3; ++expected) {
      CHECK(require_ok(store.next_event_sequence()) == expected);
      require_ok(store.enqueue_event(event(expected)));
    }
    require_ok(store.acknowledge(2));
    CHECK(require_ok(store.waiting_event_count()) == 1);
    CHECK(require_ok(store.waiting_events(0, 5)).front().sequence == 3);
    require_ok(store.acknowledge(3));
    CHECK(require_ok(store.waiting_event_count()) == 0);
  }
  Store store = open();
  CHECK(require_ok(store.next_event_sequence()) == 4);
  require_ok(store.enqueue_event(event(4)));
  require_ok(store.acknowledge(1'000));
  CHECK(require_ok(store.next_event_sequence()) == 5);
}

TEST_CASE_METHOD(StoreFixture, "an event with another number than the next one is refused") {
  Store store = open();
  require_ok(store.enqueue_event(event(1)));
  for (const std::uint64_t sequence : {0, 1, 3}) CHECK_FALSE(store.enqueue_event(event(sequence)));
  CHECK(require_ok(store.waiting_event_count()) == 1);
}

TEST_CASE_METHOD(StoreFixture, "waiting events come oldest first, above a number, no more than asked for") {
  Store store = open();
  for (std::uint64_t i = 1; i <= 5; ++i) require_ok(store.enqueue_event(event(i)));
  const auto events = require_ok(store.waiting_events(1, 3));
  REQUIRE(events.size() == 3);
  for (std::size_t i = 0; i < 3; ++i) CHECK(events[i].sequence == i + 2);
  CHECK(require_ok(store.waiting_events(0, 0)).empty());
  CHECK(require_ok(store.waiting_events(5, 3)).empty());
}

TEST_CASE_METHOD(StoreFixture, "states are forgotten alone, and an event is replaced where it stands") {
  Store store = open();
  require_ok(store.enqueue_event(event(1)));
  require_ok(store.enqueue_event(event(2, Store::Priority::state)));
  require_ok(store.enqueue_event(event(3, Store::Priority::gap)));
  require_ok(store.forget_states());
  require_ok(store.replace_event(event(1, Store::Priority::alert, "another")));
  const auto events = require_ok(store.waiting_events(0, 9));
  REQUIRE(events.size() == 2);
  CHECK(events[0].json == "another");
  CHECK(events[1].sequence == 3);
}

TEST_CASE_METHOD(StoreFixture, "the latest alerts stay, and their numbers go on") {
  Store store = open();
  for (std::uint64_t i = 1; i <= 100; ++i) CHECK(require_ok(store.keep_alert(std::to_string(i))) == i);
  const auto all = require_ok(store.latest_alerts(1000));
  REQUIRE(all.size() == Store::kept_alerts);
  CHECK(all.front().sequence == 101 - Store::kept_alerts);
  CHECK(all.back().json == "100");
  CHECK(require_ok(store.latest_alerts(2)).front().sequence == 99);
  CHECK(require_ok(store.next_alert_sequence()) == 101);
}

TEST_CASE_METHOD(StoreFixture, "a full outbox of the longest events takes less than 10 MB") {
  Store store = open();
  const std::string longest(Store::max_event_bytes, 'x');
  require_ok(store.in_transaction([&]() -> Result<void> {
    for (std::uint64_t i = 1; i <= Store::max_waiting_events; ++i)
      if (auto queued = store.enqueue_event(event(i, Store::Priority::alert, longest)); !queued) return queued;
    return {};
  }));
  { const Store moved = std::move(store); }  // closed: all is in the one file
  CHECK(std::filesystem::file_size(file) < 10'000'000);
}

TEST_CASE_METHOD(StoreFixture, "a store of schema 1 is brought to the present one, and what waits in it is kept") {
  std::vector<SignedRecord> chain;
  {
    Store store = open();
    chain = append_chain(store, 2);
    require_ok(store.save_state("front", "state"));
  }
  tamper(std::string("DROP TABLE record; DROP TABLE state; DROP TABLE outbox; DROP TABLE alert; DROP TABLE feed;") +
         schema_1);
  const int waiting = GENERATE(0, 40, 5000);
  tamper("WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE i < 7 + " + std::to_string(waiting) +
         ") INSERT INTO outbox SELECT i, 'alert ' || i FROM n; DELETE FROM outbox WHERE sequence <= 7");
  SECTION("it is read as it is") {
    CHECK(require_ok(open(Store::Mode::read_only).record_count()) == 0);
    CHECK(require_ok(open(Store::Mode::read_only).record_count()) == 0);
  }
  SECTION("it is written") {
    {
      Store store = open();
      require_ok(store.append_record(1, "front", chain[0]));
    }
    const Store store = open();
    const auto last = static_cast<std::uint64_t>(waiting + 7);
    CHECK(require_ok(store.record_count()) == 1);
    CHECK(require_ok(store.next_alert_sequence()) == last + 1);
    CHECK(require_ok(store.next_event_sequence()) == last + 1);
    CHECK(require_ok(store.latest_alerts(100)).size() == static_cast<std::size_t>(std::min(waiting, 32)));
    const auto events = require_ok(store.waiting_events(0, 10'000));
    REQUIRE(events.size() == static_cast<std::size_t>(std::min(waiting, 4800)));
    if (waiting > 0) {
      CHECK(events.back().sequence == last);
      CHECK(events.back().json == "alert " + std::to_string(last));
      CHECK(events.back().priority == Store::Priority::unsent_alert);
    }
  }
}
