#include "calib/store.hpp"

#include <signal.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <thread>

#include "support/catch.hpp"
#include "support/store_fixture.hpp"

using namespace calib;
using namespace calib::test;
using Catch::Matchers::ContainsSubstring;

namespace {

/// What `work` gives in a process of its own, as its exit status; -1 when it was killed.
template <typename Work>
int in_child(Work work) {
  const pid_t child = fork();
  if (child == 0) {
    int exit = 99;
    try {
      exit = work();
    } catch (...) {
    }
    _exit(exit);
  }
  int ended = 0;
  waitpid(child, &ended, 0);
  return WIFEXITED(ended) ? WEXITSTATUS(ended) : -1;
}

Store::Event event(std::uint64_t sequence) { return {sequence, Store::Priority::alert, {}, "{}"}; }

}  // namespace

TEST_CASE_METHOD(StoreFixture, "a new store is empty") {
  const Store store = open();
  CHECK(require_ok(store.record_count()) == 0);
  CHECK(store.record(1).error().code == "record_not_found");
  CHECK(require_ok(store.state("front")) == std::nullopt);
  CHECK(require_ok(store.next_alert_sequence()) == 1);
  CHECK(require_ok(store.latest_alerts(10)).empty());
  CHECK(require_ok(store.next_event_sequence()) == 1);
  CHECK(require_ok(store.waiting_events(0, 10)).empty());
  CHECK(require_ok(store.waiting_event_count()) == 0);
  CHECK(require_ok(store.feed_memory()) == std::nullopt);
  CHECK(require_ok(verified_history(store, key.public_key())).empty());
}

TEST_CASE_METHOD(StoreFixture, "records, state, alerts and events are there again after a restart, byte for byte") {
  std::vector<SignedRecord> chain;
  const std::string hostile = std::string("zero\0'; DROP TABLE record; --\"\n\xff", 33);
  {
    Store store = open();
    chain = append_chain(store, 5);
    require_ok(store.save_state("front", "{\"old\":1}"));
    require_ok(store.save_state("front", hostile));
    require_ok(store.save_state("", ""));
    CHECK(require_ok(store.keep_alert("first")) == 1);
    CHECK(require_ok(store.keep_alert(hostile)) == 2);
    require_ok(store.enqueue_event({1, Store::Priority::state, std::chrono::seconds(5), "{}"}));
    require_ok(store.enqueue_event({2, Store::Priority::alert, std::chrono::seconds(7), hostile}));
    require_ok(store.save_feed_memory("old"));
    require_ok(store.save_feed_memory(hostile));
  }
  const Store store = open();
  REQUIRE(require_ok(store.record_count()) == 5);
  for (std::size_t i = 0; i < chain.size(); ++i) {
    const SignedRecord record = require_ok(store.record(i + 1));
    CHECK(record.canonical == chain[i].canonical);
    CHECK(record.signature == chain[i].signature);
  }
  CHECK(require_ok(store.state("front")) == hostile);
  CHECK(require_ok(store.state("")) == "");
  CHECK(require_ok(store.state("rear")) == std::nullopt);
  const auto alerts = require_ok(store.latest_alerts(10));
  REQUIRE(alerts.size() == 2);
  CHECK(alerts[1].json == hostile);
  const auto events = require_ok(store.waiting_events(0, 10));
  REQUIRE(events.size() == 2);
  CHECK((events[0].sequence == 1 && events[0].priority == Store::Priority::state));
  CHECK((events[1].sequence == 2 && events[1].priority == Store::Priority::alert));
  CHECK(events[1].expires == std::chrono::seconds(7));
  CHECK(events[1].json == hostile);
  CHECK(require_ok(store.feed_memory()) == hostile);
  CHECK(require_ok(verified_history(store, key.public_key())).size() == 5);
}

TEST_CASE_METHOD(StoreFixture, "a record that does not follow the last one is refused") {
  Store store = open();
  const auto chain = append_chain(store, 2);
  for (const std::uint64_t sequence : {0, 1, 2, 4})
    CHECK(store.append_record(sequence, "front", chain[0]).error().code == "broken_chain");
  CHECK(require_ok(store.record_count()) == 2);
}

TEST_CASE_METHOD(StoreFixture, "the history fails at the first record that was touched, and shows those before it") {
  Store store = open();
  append_chain(store, 5);
  const auto [sql, code] = GENERATE(table<std::string, std::string>(
      {{"UPDATE record SET canonical = replace(canonical, '1', '2') WHERE sequence = 3", "bad_signature"},
       {"DELETE FROM record WHERE sequence = 3", "broken_chain"},
       {"UPDATE record SET canonical = (SELECT canonical FROM record WHERE sequence = 4),"
        " signature = (SELECT signature FROM record WHERE sequence = 4) WHERE sequence = 3",
        "broken_chain"},
       {"UPDATE record SET signature = '' WHERE sequence = 3", "bad_signature"}}));
  tamper(sql);
  INFO(sql);
  const auto history = verified_history(store, key.public_key());
  REQUIRE_FALSE(history);
  CHECK(history.error().code == code);
  CHECK_THAT(history.error().context, ContainsSubstring("record 3 "));
  std::size_t shown = 0;
  CHECK_FALSE(visit_verified(
      require_ok(store.record_count()), [&](std::uint64_t sequence) { return store.record(sequence); },
      key.public_key(), [&](const auto& record, const auto&) { CHECK(record.sequence == ++shown); }));
  CHECK(shown == 2);
}

TEST_CASE_METHOD(StoreFixture, "the history of another key names both keys") {
  Store store = open();
  append_chain(store, 1);
  const auto history = verified_history(store, SigningKey::generate().public_key());
  REQUIRE_FALSE(history);
  CHECK(history.error().code == "wrong_key");
  CHECK_THAT(history.error().context, ContainsSubstring("signed by key " + key.public_key().id_text()));
}

TEST_CASE_METHOD(StoreFixture, "a transaction keeps all of its writes or none") {
  Store store = open();
  const auto chain = random_chain(random, 1, key);
  const auto write_all = [&](Result<void> end) {
    return store.in_transaction([&]() -> Result<void> {
      require_ok(store.append_record(1, "front", chain[0]));
      require_ok(store.save_state("front", "after"));
      CHECK(store.keep_alert("{}"));
      require_ok(store.enqueue_event(event(1)));
      return end;
    });
  };
  const auto failed = write_all(fail(ErrorCode::low_overlap, "said by the body"));
  REQUIRE_FALSE(failed);
  CHECK(failed.error().code == "low_overlap");
  CHECK(require_ok(store.record_count()) == 0);
  CHECK(require_ok(store.state("front")) == std::nullopt);
  CHECK(require_ok(store.next_alert_sequence()) == 1);
  CHECK(require_ok(store.next_event_sequence()) == 1);

  CHECK_THROWS_AS((void)store.in_transaction([&]() -> Result<void> {
    require_ok(store.save_state("front", "thrown"));
    throw std::runtime_error("out of the body");
  }),
                  std::runtime_error);
  CHECK(require_ok(store.state("front")) == std::nullopt);

  require_ok(write_all({}));
  CHECK(require_ok(store.record_count()) == 1);
  CHECK(require_ok(store.state("front")) == "after");
}

TEST_CASE_METHOD(StoreFixture, "reading works while the writer has a transaction open") {
  Store writer = open();
  append_chain(writer, 2);
  const Store reader = open(Store::Mode::read_only);
  require_ok(writer.in_transaction([&]() -> Result<void> {
    require_ok(writer.save_state("front", "new"));
    CHECK(require_ok(reader.record_count()) == 2);
    CHECK(require_ok(reader.state("front")) == std::nullopt);
    return {};
  }));
  CHECK(require_ok(reader.state("front")) == "new");
}

TEST_CASE_METHOD(StoreFixture, "a reader without write permission reads with the writer alive, closed, and killed") {
  const auto count_as_stranger = [&] {
    return in_child([&] {
      // Without any permission to write, to the folder as well; root would have it regardless.
      if (geteuid() == 0 && (setgid(65534) != 0 || setuid(65534) != 0)) return 98;
      if (access(file.c_str(), W_OK) == 0 || access(folder.path().c_str(), W_OK) == 0) return 97;
      return static_cast<int>(require_ok(open(Store::Mode::read_only).record_count()));
    });
  };
  const auto lock = [&](bool locked) {
    chmod(folder.path().c_str(), locked ? 0555 : 0755);
    for (const char* suffix : {"", "-wal", "-shm"}) chmod((file.string() + suffix).c_str(), locked ? 0444 : 0644);
  };
  {
    Store writer = open();
    append_chain(writer, 3);
    lock(true);
    CHECK(count_as_stranger() == 3);
    lock(false);
  }
  lock(true);
  CHECK(count_as_stranger() == 3);
  lock(false);

  const int killed = in_child([&] {
    Store writer = open();
    const auto more = require_ok(writer.record(3));
    require_ok(
        writer.append_record(4, "front", sign_next(random_record(random), std::vector<SignedRecord>(3, more), key)));
    return raise(SIGKILL);
  });
  REQUIRE(killed == -1);
  lock(true);
  CHECK(count_as_stranger() == 4);
  lock(false);
}

TEST_CASE_METHOD(StoreFixture, "what had returned is there after kill -9 at any moment") {
  std::uniform_int_distribution<int> moment_us(0, 60'000);
  std::uint64_t promised = 0;
  for (int round = 0; round < 25; ++round) {
    int pipe_ends[2];
    REQUIRE(pipe(pipe_ends) == 0);
    const pid_t writer = fork();
    if (writer == 0) {
      // Everything that belongs together in one transaction; then the promise, through the pipe.
      Store store = open();
      for (std::uint64_t last = require_ok(store.record_count());; ++last) {
        const std::string previous =
            last == 0 ? std::string(no_previous_sha256) : sha256_hex(require_ok(store.record(last)).canonical);
        CalibrationRecord record = random_record(random);
        record.sequence = last + 1;
        record.previous_sha256 = previous;
        const SignedRecord bytes = require_ok(sign_record(record, key));
        require_ok(store.in_transaction([&]() -> Result<void> {
          require_ok(store.append_record(last + 1, "front", bytes));
          require_ok(store.save_state("front", std::to_string(last + 1)));
          CHECK(store.keep_alert(std::to_string(last + 1)));
          require_ok(store.enqueue_event(event(last + 1)));
          return {};
        }));
        const std::uint64_t done = last + 1;
        if (write(pipe_ends[1], &done, sizeof done) != sizeof done) _exit(1);
      }
    }
    close(pipe_ends[1]);
    std::this_thread::sleep_for(std::chrono::microseconds(moment_us(random)));
    kill(writer, SIGKILL);
    waitpid(writer, nullptr, 0);
    std::uint64_t done = 0;
    while (read(pipe_ends[0], &done, sizeof done) == sizeof done) promised = done;
    close(pipe_ends[0]);

    const Store store = open();
    const std::uint64_t count = require_ok(store.record_count());
    REQUIRE(count >= promised);
    REQUIRE(count <= promised + 1);  // at most one was done and not yet promised
    REQUIRE(require_ok(verified_history(store, key.public_key())).size() == count);
    REQUIRE(require_ok(store.state("front")) == (count == 0 ? std::nullopt : std::optional(std::to_string(count))));
    REQUIRE(require_ok(store.waiting_event_count()) == count);
    REQUIRE(require_ok(store.next_event_sequence()) == count + 1);
    REQUIRE(require_ok(store.next_alert_sequence()) == count + 1);
    promised = count;
  }
  CHECK(promised > 0);
}

TEST_CASE_METHOD(StoreFixture, "a file that is no store of ours, or of a newer calibd, is refused") {
  CHECK(Store::open(file, Store::Mode::read_only).error().code == "store_not_found");
  CHECK_FALSE(std::filesystem::exists(file));
  CHECK(Store::open(folder.path() / "no_folder" / "x", Store::Mode::read_write).error().code == "store_failed");
  { const Store store = open(); }
  tamper("PRAGMA user_version = 3");
  for (const auto mode : {Store::Mode::read_only, Store::Mode::read_write}) {
    const auto newer = Store::open(file, mode);
    REQUIRE_FALSE(newer);
    CHECK(newer.error().code == "store_version");
  }
  const auto text_file = folder.path() / "text";
  for (const char* end : {"", "-wal", "-shm"}) std::filesystem::remove(file.string() + end);
  FILE* const text = fopen(text_file.c_str(), "w");
  fputs(
      "this is a text and not a database, long enough to have a header of one hundred bytes "
      "...................",
      text);
  fclose(text);
  CHECK(Store::open(text_file, Store::Mode::read_only).error().code == "store_failed");
  CHECK(Store::open(text_file, Store::Mode::read_write).error().code == "store_failed");
  tamper("VACUUM");  // an empty database
  CHECK(Store::open(file, Store::Mode::read_only).error().code == "store_not_found");
}

TEST_CASE_METHOD(StoreFixture, "a closed store is one file: another put in its place is read as it is") {
  {
    Store store = open();
    append_chain(store, 3);
  }
  const auto other = folder.path() / "other.db";
  require_ok(require_ok(Store::open(other, Store::Mode::read_write)).save_state("front", "of the other"));
  std::filesystem::copy_file(other, file, std::filesystem::copy_options::overwrite_existing);
  const Store store = open(Store::Mode::read_only);
  CHECK(require_ok(store.record_count()) == 0);
  CHECK(require_ok(store.state("front")) == "of the other");
}

TEST_CASE_METHOD(StoreFixture, "a write that fails says so and changes nothing") {
  Store store = open();
  append_chain(store, 1);
  const Store reader = open(Store::Mode::read_only);
  Store no_writer = open(Store::Mode::read_only);
  CHECK(no_writer.save_state("front", "{}").error().code == "store_failed");
  CHECK(no_writer.keep_alert("{}").error().code == "store_failed");
  CHECK(no_writer.enqueue_event(event(1)).error().code == "store_failed");
  const auto in_transaction = no_writer.in_transaction([&] { return no_writer.save_state("front", "{}"); });
  REQUIRE_FALSE(in_transaction);
  CHECK(in_transaction.error().code == "store_failed");
  CHECK(require_ok(reader.state("front")) == std::nullopt);
}
