// The ledger's own transactions on a disk whose power fails at any moment: no acknowledged record is lost, and the
// chain is never broken.
#include <cstdlib>
#include <fstream>
#include <iterator>
#include <random>

#include "ledger.hpp"
#include "support/catch.hpp"
#include "support/crash_vfs.hpp"
#include "support/support.hpp"

using namespace calib;
using namespace std::chrono_literals;
using test::require_ok;

namespace {

const Provenance provenance{"car", std::string(64, 'c'), "1.2.3", std::string(64, 'd'), "boot"};
constexpr std::array pairs{"front", "rear"};

std::string content_of(const std::filesystem::path& file) {
  std::ifstream in(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

/// What has been acknowledged when so many operations had been asked of the disk.
struct Acknowledged {
  std::size_t operations = 0;
  std::vector<std::string> records{};                             // canonical bytes
  std::map<std::string, std::uint64_t, std::less<>> evaluated{};  // of the state, by pair
  std::uint64_t alerts = 0;
};

/// A vehicle's life in the ledger, and what the disk was asked for.
struct Life {
  Life() {
    for (const char* name : {"a", "b"})
      require_ok(SigningKey::generate().save(keys.path() / (std::string(name) + ".key")));
    const test::RecordingVfs vfs([this] { heads.push_back(content_of(folder.path() / "chain-head.json")); });
    acknowledged.push_back({});
    for (int start = 0; start < 6; ++start) {
      auto ledger = require_ok(Ledger::open(folder.path(), folder.path(), key(start < 4 ? "a" : "b"), provenance));
      acknowledge(vfs);
      for (int i = 0; i < 12; ++i) write(ledger, vfs);
      if (start == 3) {
        std::map<std::string_view, const PairState*> states;
        for (const char* pair : pairs) states.emplace(pair, &state[pair]);
        REQUIRE(ledger.change_key({key("b"), {}, "uid:0", {}}, states, now()));
        acknowledge(vfs);
        write(ledger, vfs);
      }
    }
    operations = vfs.operations();
    heads.push_back(content_of(folder.path() / "chain-head.json"));
  }

  [[nodiscard]] SigningKey key(const std::string& name) const {
    return require_ok(SigningKey::load(keys.path() / (name + ".key")));
  }

  void write(Ledger& ledger, const test::RecordingVfs& vfs) {
    const char* const pair = pairs[random() % 2];
    ++state[pair].evaluated;
    state[pair].reason = std::string(random() % 9000, 'r');  // of several pages, now and then
    Ledger::Entry entry;
    if (ledger.history(pair).in_force() == nullptr || random() % 2 == 0) {
      CalibrationRecord& record = entry.record.emplace();
      record.decision = ledger.history(pair).in_force() == nullptr ? Decision::initial : Decision::accepted;
      record.asked_by = "calibd";
      record.reason = std::string(random() % 3000, 'x');
      record.evidence_sha256 = std::string(64, 'e');
    }
    if (random() % 3 == 0) {
      entry.alert.emplace();
      entry.alert->pair = pair;
    }
    alerts += entry.alert.has_value();
    REQUIRE(ledger.write(pair, state[pair], std::move(entry), now()));
    acknowledge(vfs);
  }
  void acknowledge(const test::RecordingVfs& vfs) {
    const auto store = require_ok(Store::open(folder.path() / "calibd.db", Store::Mode::read_only));
    Acknowledged made{.operations = vfs.operations().size(), .alerts = alerts};
    const auto count = require_ok(store.record_count());
    for (std::uint64_t sequence = 1; sequence <= count; ++sequence)
      made.records.push_back(require_ok(store.record(sequence)).canonical);
    for (const auto& [pair, saved] : state) made.evaluated[pair] = saved.evaluated;
    acknowledged.push_back(std::move(made));
  }
  Moment now() { return {1'700'000'000s + std::chrono::seconds(acknowledged.size()), 42s}; }

  test::TemporaryFolder folder, keys;
  std::mt19937 random{7};
  std::map<std::string, PairState, std::less<>> state;
  std::uint64_t alerts = 0;
  std::vector<Acknowledged> acknowledged;
  std::vector<test::DiskOperation> operations;
  std::vector<std::string> heads;  // chain-head.json, which is synced whenever it is written, before each operation
};

int number_of_states() {
  const char* const wanted = std::getenv("CALIBD_CRASH_STATES");
  return wanted != nullptr ? std::atoi(wanted) : 2000;
}

const Acknowledged& acknowledged_at(const Life& life, std::size_t count) {
  const Acknowledged* known = &life.acknowledged.front();
  for (const Acknowledged& each : life.acknowledged)
    if (each.operations <= count) known = &each;
  return *known;
}

/// As the daemon would start after the power cut; with the second key, where that is the chain's.
Result<Ledger> open_after(const Life& life, const test::CrashedDisk& disk, std::size_t count,
                          const std::filesystem::path& folder) {
  disk.put_into(folder);
  if (const std::string& head = life.heads[count]; !head.empty()) std::ofstream(folder / "chain-head.json") << head;
  auto opened = Ledger::open(folder, folder, life.key("a"), provenance);
  return opened && opened->signing_refused() ? Ledger::open(folder, folder, life.key("b"), provenance)
                                             : std::move(opened);
}

}  // namespace

TEST_CASE("a power cut at any moment loses no acknowledged record and breaks no chain", "[release-only]") {
  Life life;
  REQUIRE(life.operations.size() > 500);
  REQUIRE(life.acknowledged.back().records.size() > 30);
  int with_unsynced = 0, more_than_acknowledged = 0;
  for (int number = 0; number < number_of_states(); ++number) {
    std::mt19937 random(static_cast<unsigned>(number));
    const std::size_t count = random() % (life.operations.size() + 1);
    const test::CrashedDisk disk(life.operations, count, random);
    with_unsynced += disk.had_unsynced();
    const Acknowledged* const known = &acknowledged_at(life, count);
    INFO("state " << number << ", after " << count << " operations and " << known->records.size() << " records");
    const test::TemporaryFolder folder;
    auto opened = open_after(life, disk, count, folder.path());
    if (!opened) FAIL(opened.error().context);
    Ledger& ledger = *opened;
    CHECK_FALSE(ledger.signing_refused());
    CHECK_FALSE(ledger.records_missing());
    const std::uint64_t records = ledger.next_sequence() - 1;
    REQUIRE(records >= known->records.size());
    REQUIRE(records <= known->records.size() + 1);  // the one that was being written
    more_than_acknowledged += records > known->records.size();
    {
      const auto store = require_ok(Store::open(folder.path() / "calibd.db", Store::Mode::read_only));
      for (std::uint64_t sequence = 1; sequence <= known->records.size(); ++sequence)
        REQUIRE(require_ok(store.record(sequence)).canonical == known->records[sequence - 1]);
    }
    CHECK(require_ok(ledger.latest_alerts(32)).alerts.size() >= std::min<std::size_t>(32, known->alerts));
    CHECK(ledger.waiting_event_count() >= known->records.size());  // each is an event
    for (const auto& [pair, evaluated] : known->evaluated) {
      const auto state = require_ok(ledger.state(pair));
      REQUIRE(state);
      CHECK(state->evaluated >= evaluated);
      CHECK(state->evaluated <= evaluated + 1);
    }
    CalibrationRecord next;
    next.decision = Decision::initial;
    next.evidence_sha256 = std::string(64, 'e');
    REQUIRE(ledger.write("front", {}, {next, {}}, life.now()));
  }
  // The states are of some use: most were open to chance, and in some the last record has just made it.
  CHECK(with_unsynced > number_of_states() / 3);
  CHECK(more_than_acknowledged > 0);
}

TEST_CASE("records that a disk loses which does not sync are missed by name", "[release-only]") {
  Life life;
  auto unsynced = life.operations;
  for (test::DiskOperation& operation : unsynced) operation.with_folder = false;
  std::erase_if(unsynced, [](const auto& operation) { return operation.kind == test::DiskOperation::Kind::sync; });
  int lost = 0;
  for (int number = 0; number < 200; ++number) {
    std::mt19937 random(static_cast<unsigned>(number));
    const test::CrashedDisk disk(unsynced, unsynced.size(), random);
    const Acknowledged& known = life.acknowledged.back();
    const test::TemporaryFolder folder;
    const auto opened = open_after(life, disk, life.operations.size(), folder.path());
    if (opened && !opened->records_missing()) {
      CHECK(opened->next_sequence() == known.records.size() + 1);
      continue;
    }
    ++lost;
    if (!opened) CHECK((opened.error().code == "store_failed" || opened.error().code == "bad_signature"));
    if (opened) CHECK_THAT(*opened->records_missing(), Catch::Matchers::ContainsSubstring("missing"));
  }
  CHECK(lost > 50);
}

TEST_CASE("a full, failing or read-only disk and a clock that is set back lose no acknowledged record") {
  const int code = GENERATE(SQLITE_FULL, SQLITE_IOERR_WRITE, SQLITE_IOERR_FSYNC, SQLITE_READONLY);
  for (int operations = 0; operations < 12; ++operations) {
    INFO("code " << code << ", after " << operations << " operations");
    const test::TemporaryFolder folder, keys;
    for (const char* name : {"a", "b"})
      require_ok(SigningKey::generate().save(keys.path() / (std::string(name) + ".key")));
    const auto key = [&](const char* name) {
      return require_ok(SigningKey::load(keys.path() / (std::string(name) + ".key")));
    };
    test::RecordingVfs vfs([] {});
    Moment now{1'700'000'000s, 42s};
    std::uint64_t acknowledged = 0;
    int failed = 0;
    const auto write = [&](Ledger& ledger) {
      CalibrationRecord record;
      record.decision = Decision::initial;
      record.evidence_sha256 = std::string(64, 'e');
      const auto written = ledger.write("front", {}, {record, {}}, now);
      if (written)
        acknowledged = written->record->sequence;
      else
        CHECK(written.error().code == "store_failed");
      failed += !written;
      return written.has_value();
    };
    {
      auto ledger = require_ok(Ledger::open(folder.path(), folder.path(), key("a"), provenance));
      REQUIRE(write(ledger));
      vfs.fail_after(operations, code);
      for (int i = 0; i < 6; ++i) (void)write(ledger);
      CHECK((failed > 0 || operations >= 6));
      vfs.fail_after(0, code);
      PairState state;
      const auto changed = ledger.change_key({key("b"), {}, "uid:0", {}}, {{"front", &state}}, now);
      REQUIRE_FALSE(changed);
      CHECK(changed.error().code == "store_failed");
      CHECK(ledger.key_id() == key("a").public_key().id_text());
      vfs.heal();
      now.wall -= std::chrono::hours(24 * 3652);
      REQUIRE(write(ledger));
      CHECK(ledger.next_sequence() == acknowledged + 1);
    }
    auto ledger = require_ok(Ledger::open(folder.path(), folder.path(), key("a"), provenance));
    CHECK_FALSE(ledger.records_missing());
    CHECK(ledger.next_sequence() == acknowledged + 1);
    REQUIRE(write(ledger));
  }
}
