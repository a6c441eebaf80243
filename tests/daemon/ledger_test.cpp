#include "ledger.hpp"

#include <sqlite3.h>

#include <fstream>
#include <limits>

#include "support/catch.hpp"
#include "support/support.hpp"

using namespace calib;
using namespace std::chrono_literals;

namespace {

constexpr Moment moment{1'700'000'000s, 42s};
const Provenance provenance{"car", std::string(64, 'c'), "1.2.3", std::string(64, 'd'), "boot"};

struct Garage {
  Garage() { test::require_ok(SigningKey::generate().save(key_file)); }
  [[nodiscard]] Result<Ledger> open() const {
    return Ledger::open(folder.path(), folder.path(), test::require_ok(SigningKey::load(key_file)), provenance);
  }
  test::TemporaryFolder folder;
  std::filesystem::path key_file = folder.path() / "signing.key";
};

CalibrationRecord decided(Decision decision, double x_m) {
  CalibrationRecord record;
  record.decision = decision;
  record.asked_by = "calibd";
  record.reason = "a test";
  record.evidence_sha256 = std::string(64, 'e');
  record.T_camera_lidar.translation().x() = x_m;
  return record;
}

DriftAlert alert_of(Verdict verdict) {
  DriftAlert alert;
  alert.stamp = moment.wall;
  alert.vehicle = "car";
  alert.pair = "front";
  alert.verdict = verdict;
  alert.reason = "yaw \x1b[31m";
  alert.misalignment.delta << 1, -2, 3, -4, 5, -6;
  alert.record_sequence = 1;
  return alert;
}

void execute(const std::filesystem::path& file, const char* sql) {
  sqlite3* database = nullptr;
  REQUIRE(sqlite3_open(file.c_str(), &database) == SQLITE_OK);
  CHECK(sqlite3_exec(database, sql, nullptr, nullptr, nullptr) == SQLITE_OK);
  sqlite3_close(database);
}

}  // namespace

TEST_CASE("a ledger opened again knows what was written, by pair") {
  const Garage garage;
  PairState state;
  state.evaluated = 7;
  {
    auto ledger = test::require_ok(garage.open());
    CHECK(ledger.history("front").in_force() == nullptr);
    for (const char* pair : {"front", "rear"})
      REQUIRE(ledger.write(pair, state, {decided(Decision::initial, 1), {}}, moment));
    REQUIRE(ledger.write("front", state, {decided(Decision::rejected, 2), {}}, moment));
    REQUIRE(ledger.write("front", state, {decided(Decision::accepted, 3), {}}, moment));
  }
  const auto ledger = test::require_ok(garage.open());
  CHECK(ledger.next_sequence() == 5);
  CHECK(ledger.history("front").in_force()->T_camera_lidar.translation().x() == 3);
  CHECK(ledger.history("front").before_in_force()->T_camera_lidar.translation().x() == 1);
  CHECK(ledger.history("front").initial->sequence == 1);
  CHECK(ledger.history("rear").in_force()->sequence == 2);
  CHECK(ledger.history("rear").before_in_force() == nullptr);
  CHECK(test::require_ok(ledger.find("front", 3)).decision == Decision::rejected);
  CHECK(ledger.find("rear", 3).error().code == "record_not_found");
  CHECK(ledger.find("front", 9).error().code == "record_not_found");
  CHECK(test::require_ok(ledger.state("front"))->evaluated == 7);
  CHECK_FALSE(test::require_ok(ledger.state("left")).has_value());
}

TEST_CASE("a baseline belongs to an extrinsic, puts nothing in force, and is found again when that extrinsic is") {
  const Garage garage;
  const auto baseline = [](double x_m, std::uint64_t pairs) {
    CalibrationRecord record = decided(Decision::baseline, x_m);
    record.baseline.emplace().pairs = pairs;
    return record;
  };
  {
    auto ledger = test::require_ok(garage.open());
    CHECK(ledger.history("front").baseline() == nullptr);
    for (const CalibrationRecord& record :
         {decided(Decision::initial, 1), baseline(1, 20), baseline(1, 100), decided(Decision::accepted, 2)})
      REQUIRE(ledger.write("front", {}, {record, {}}, moment));
    CHECK(ledger.history("front").in_force()->sequence == 4);
    CHECK(ledger.history("front").baseline() == nullptr);
    REQUIRE(ledger.write("front", {}, {baseline(2, 21), {}}, moment));
    CHECK(ledger.history("front").in_force()->sequence == 4);
    CHECK(ledger.history("front").before_in_force()->sequence == 1);
    CHECK(ledger.history("front").baseline()->baseline->pairs == 21);
    REQUIRE(ledger.write("front", {}, {decided(Decision::rolled_back, 1), {}}, moment));
  }
  const auto ledger = test::require_ok(garage.open());
  CHECK(ledger.history("front").baseline()->sequence == 3);
  CHECK(ledger.history("front").baseline()->baseline->pairs == 100);
  CHECK(ledger.history("rear").baseline() == nullptr);
}

TEST_CASE("an alert comes back as it was enqueued, numbered without a gap") {
  const Garage garage;
  {
    auto ledger = test::require_ok(garage.open());
    for (const Verdict verdict : {Verdict::suspect, Verdict::drifted})
      REQUIRE(ledger.write("front", {}, {{}, alert_of(verdict)}, moment));
  }
  const auto ledger = test::require_ok(garage.open());
  const auto waiting = test::require_ok(ledger.latest_alerts(10)).alerts;
  REQUIRE(waiting.size() == 2);
  CHECK(ledger.waiting_event_count() == 2);
  CHECK(waiting[1].alert_sequence == waiting[0].alert_sequence + 1);
  CHECK(waiting[1].verdict == Verdict::drifted);
  CHECK(waiting[1].stamp == moment.wall);
  CHECK(waiting[1].reason == alert_of(Verdict::drifted).reason);
  CHECK(waiting[1].misalignment.delta == alert_of(Verdict::drifted).misalignment.delta);
}

TEST_CASE("what cannot be written whole is not written at all") {
  const Garage garage;
  auto ledger = test::require_ok(garage.open());
  PairState state;
  state.evaluated = 1;
  REQUIRE(ledger.write("front", state, {decided(Decision::initial, 1), {}}, moment));
  REQUIRE(ledger.waiting_event_count() == 1);  // of that record
  state.evaluated = 2;
  const auto refused = ledger.write(
      "front", state,
      {decided(Decision::accepted, std::numeric_limits<double>::quiet_NaN()), alert_of(Verdict::suspect)}, moment);
  REQUIRE_FALSE(refused);
  CHECK(ledger.next_sequence() == 2);
  CHECK(ledger.waiting_event_count() == 1);
  CHECK(test::require_ok(ledger.latest_alerts(9)).alerts.empty());
  CHECK(test::require_ok(ledger.state("front"))->evaluated == 1);
  CHECK(ledger.history("front").in_force()->decision == Decision::initial);
  REQUIRE(ledger.write("front", state, {decided(Decision::accepted, 2), {}}, moment));
  CHECK(test::require_ok(garage.open()).next_sequence() == 3);
}

TEST_CASE("a ledger whose records were tampered with does not open") {
  const Garage garage;
  {
    auto ledger = test::require_ok(garage.open());
    for (double x : {1.0, 2.0, 3.0}) REQUIRE(ledger.write("front", {}, {decided(Decision::accepted, x), {}}, moment));
  }
  SECTION("one removed") { execute(garage.folder.path() / "calibd.db", "delete from record where sequence = 2"); }
  SECTION("one changed") {
    execute(garage.folder.path() / "calibd.db",
            "update record set canonical = replace(canonical, 'a test', 'a jest') where sequence = 2");
  }
  CHECK_FALSE(garage.open());
}

TEST_CASE("the latest alerts are those that late readers get, and one that cannot be read costs no other") {
  const Garage garage;
  auto ledger = test::require_ok(garage.open());
  for (int i = 0; i < 40; ++i) REQUIRE(ledger.write("front", {}, {{}, alert_of(Verdict::drifted)}, moment));
  execute(garage.folder.path() / "calibd.db", "update alert set json = 'spoilt' where sequence = 20");
  const auto latest = test::require_ok(ledger.latest_alerts(32));
  REQUIRE(latest.alerts.size() == 31);
  CHECK(latest.alerts.front().alert_sequence == 9);
  CHECK(latest.alerts.back().alert_sequence == 40);
  REQUIRE(latest.unreadable.size() == 1);
  CHECK_THAT(latest.unreadable[0].context, Catch::Matchers::StartsWith("alert 20: "));
}

TEST_CASE("records of another vehicle are refused") {
  const Garage garage;
  {
    auto ledger = test::require_ok(garage.open());
    REQUIRE(ledger.write("front", {}, {decided(Decision::initial, 1), {}}, moment));
  }
  Provenance other = provenance;
  other.vehicle = "another car";
  const auto opened = Ledger::open(garage.folder.path(), garage.folder.path(),
                                   test::require_ok(SigningKey::load(garage.key_file)), other);
  REQUIRE_FALSE(opened);
  CHECK(opened.error().code == "other_vehicle");
}

TEST_CASE("records that are missing are noticed at the next start, and told by the next record, once") {
  const Garage garage;
  const auto file = garage.folder.path() / "calibd.db";
  const auto earlier = garage.folder.path() / "earlier.db";
  {
    auto ledger = test::require_ok(garage.open());
    CHECK_FALSE(ledger.records_missing());
    for (double x : {1.0, 2.0}) REQUIRE(ledger.write("front", {}, {decided(Decision::accepted, x), {}}, moment));
  }
  std::filesystem::copy(file, earlier);
  {
    auto ledger = test::require_ok(garage.open());
    CHECK_FALSE(ledger.records_missing());
    REQUIRE(ledger.write("front", {}, {decided(Decision::accepted, 3), {}}, moment));
  }
  SECTION("the last ones were cut off") {
    execute(file, "delete from record where sequence > 1");
    CHECK_THAT(test::require_ok(garage.open()).records_missing().value(),
               Catch::Matchers::StartsWith("records 2 to 3, which calibd had written"));
  }
  SECTION("all of them were deleted") {
    execute(file, "delete from record");
    CHECK_THAT(test::require_ok(garage.open()).records_missing().value(),
               Catch::Matchers::StartsWith("records 1 to 3, which calibd had written"));
  }
  SECTION("an older store was put back") {
    std::filesystem::copy(earlier, file, std::filesystem::copy_options::overwrite_existing);
    CHECK_THAT(test::require_ok(garage.open()).records_missing().value(),
               Catch::Matchers::StartsWith("records 3 to 3, which calibd had written"));
  }
  SECTION("another history was written since an older one") {
    std::filesystem::copy_file(garage.folder.path() / "chain-head.json", garage.folder.path() / "head");
    std::filesystem::copy(earlier, file, std::filesystem::copy_options::overwrite_existing);
    {
      auto ledger = test::require_ok(garage.open());
      REQUIRE(ledger.write("front", {}, {decided(Decision::accepted, 4), {}}, moment));
    }
    std::filesystem::rename(garage.folder.path() / "head", garage.folder.path() / "chain-head.json");
    CHECK_THAT(test::require_ok(garage.open()).records_missing().value(),
               Catch::Matchers::StartsWith("record 3 is another than the one"));
  }
  SECTION("nobody knows") {
    std::filesystem::remove(garage.folder.path() / "chain-head.json");
    CHECK_THAT(test::require_ok(garage.open()).records_missing().value(),
               Catch::Matchers::StartsWith("whether records are missing cannot be told"));
  }
  SECTION("somebody has written what should be remembered") {
    std::ofstream(garage.folder.path() / "chain-head.json")
        << R"({"mac":"00","missing":null,"schema":1,"sequence":1,"sha256":""})";
    CHECK_THAT(test::require_ok(garage.open()).records_missing().value(),
               Catch::Matchers::EndsWith("was not written with this signing key"));
  }
  {
    auto ledger = test::require_ok(garage.open());  // a start later it is still not told
    REQUIRE(ledger.records_missing());
    const auto told = test::require_ok(ledger.write("front", {}, {decided(Decision::accepted, 5), {}}, moment));
    CHECK(told.record->reason == "a test; " + *ledger.records_missing());
    const auto next = test::require_ok(ledger.write("front", {}, {decided(Decision::accepted, 6), {}}, moment));
    CHECK(next.record->reason == "a test");
  }
  CHECK_FALSE(test::require_ok(garage.open()).records_missing());
}

TEST_CASE("records of the first version of calibd, which remembered no head, are taken over without a word") {
  const Garage garage;
  CalibrationRecord record = decided(Decision::initial, 1);
  record.evidence_sha256.clear();
  REQUIRE(test::require_ok(garage.open()).write("front", {}, {record, {}}, moment));
  std::filesystem::remove(garage.folder.path() / "chain-head.json");
  CHECK_FALSE(test::require_ok(garage.open()).records_missing());
}

TEST_CASE("a head that is not what calibd writes there is told in words of calibd's own") {
  const Garage garage;
  REQUIRE(test::require_ok(garage.open()).write("front", {}, {decided(Decision::initial, 1), {}}, moment));
  std::ofstream(garage.folder.path() / "chain-head.json") << GENERATE("\xff\xfe", "", "[", "{}", "{\"mac\":1}");
  const auto ledger = test::require_ok(garage.open());
  CHECK_THAT(ledger.records_missing().value(), Catch::Matchers::EndsWith("is not what calibd writes there"));
}

TEST_CASE("a state counts only as it was written, for its pair, and with the records of its time") {
  const Garage garage;
  const auto file = garage.folder.path() / "calibd.db";
  PairState state;
  state.evaluated = 7;
  {
    auto ledger = test::require_ok(garage.open());
    for (const char* pair : {"front", "rear"})
      REQUIRE(ledger.write(pair, state, {decided(Decision::initial, 1), {}}, moment));
    REQUIRE(ledger.write("front", state, {decided(Decision::accepted, 3), {}}, moment));
    CHECK(test::require_ok(ledger.state("front"))->evaluated == 7);
  }
  const auto [sql, why] = GENERATE(table<const char*, const char*>({
      {"update state set json = replace(json, '\"evaluated\":7', '\"evaluated\":8')", "was not written by calibd"},
      {"update state set json = (select json from state where pair = 'rear') where pair = 'front'",
       "is of another pair"},
      {"delete from record where sequence = 3", "is of another time than the records"},
      {"update state set json = ''", "was not written by calibd"},
      {"update state set json = '{\"schema\":2}'", "is of an earlier version of calibd"},
  }));
  execute(file, sql);
  const auto read = test::require_ok(garage.open()).state("front");
  INFO(sql);
  REQUIRE_FALSE(read);
  CHECK(read.error().code == "malformed_state");
  CHECK_THAT(read.error().context, Catch::Matchers::ContainsSubstring(why));
}

TEST_CASE("a head that cannot be remembered is told until it can") {
  const Garage garage;
  const auto head_dir = garage.folder.path() / "head";
  const auto open = [&] {
    return Ledger::open(garage.folder.path(), head_dir, test::require_ok(SigningKey::load(garage.key_file)),
                        provenance);
  };
  auto ledger = test::require_ok(open());
  REQUIRE(ledger.head_failure());
  CHECK_THAT(ledger.head_failure()->context, Catch::Matchers::ContainsSubstring("chain-head.json cannot be written"));
  std::filesystem::create_directory(head_dir);
  REQUIRE(ledger.write("front", {}, {}, moment));
  CHECK_FALSE(ledger.head_failure());
}
