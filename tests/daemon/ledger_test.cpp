#include "ledger.hpp"

#include <sqlite3.h>

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
    CHECK(ledger.in_force("front") == nullptr);
    for (const char* pair : {"front", "rear"})
      REQUIRE(ledger.write(pair, state, {decided(Decision::initial, 1), {}}, moment));
    REQUIRE(ledger.write("front", state, {decided(Decision::rejected, 2), {}}, moment));
    REQUIRE(ledger.write("front", state, {decided(Decision::accepted, 3), {}}, moment));
  }
  const auto ledger = test::require_ok(garage.open());
  CHECK(ledger.next_sequence() == 5);
  CHECK(ledger.in_force("front")->T_camera_lidar.translation().x() == 3);
  CHECK(ledger.before_in_force("front")->T_camera_lidar.translation().x() == 1);
  CHECK(ledger.initial("front")->sequence == 1);
  CHECK(ledger.in_force("rear")->sequence == 2);
  CHECK(ledger.before_in_force("rear") == nullptr);
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
    CHECK(ledger.baseline("front") == nullptr);
    for (const CalibrationRecord& record :
         {decided(Decision::initial, 1), baseline(1, 20), baseline(1, 100), decided(Decision::accepted, 2)})
      REQUIRE(ledger.write("front", {}, {record, {}}, moment));
    CHECK(ledger.in_force("front")->sequence == 4);
    CHECK(ledger.baseline("front") == nullptr);
    REQUIRE(ledger.write("front", {}, {baseline(2, 21), {}}, moment));
    CHECK(ledger.in_force("front")->sequence == 4);
    CHECK(ledger.before_in_force("front")->sequence == 1);
    CHECK(ledger.baseline("front")->baseline->pairs == 21);
    REQUIRE(ledger.write("front", {}, {decided(Decision::rolled_back, 1), {}}, moment));
  }
  const auto ledger = test::require_ok(garage.open());
  CHECK(ledger.baseline("front")->sequence == 3);
  CHECK(ledger.baseline("front")->baseline->pairs == 100);
  CHECK(ledger.baseline("rear") == nullptr);
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
  CHECK(ledger.waiting_alert_count() == 2);
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
  state.evaluated = 2;
  const auto refused = ledger.write(
      "front", state,
      {decided(Decision::accepted, std::numeric_limits<double>::quiet_NaN()), alert_of(Verdict::suspect)}, moment);
  REQUIRE_FALSE(refused);
  CHECK(ledger.next_sequence() == 2);
  CHECK(ledger.waiting_alert_count() == 0);
  CHECK(test::require_ok(ledger.state("front"))->evaluated == 1);
  CHECK(ledger.in_force("front")->decision == Decision::initial);
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

TEST_CASE("a ledger signed by another key does not open") {
  const Garage garage;
  {
    auto ledger = test::require_ok(garage.open());
    REQUIRE(ledger.write("front", {}, {decided(Decision::initial, 1), {}}, moment));
  }
  const auto opened = Ledger::open(garage.folder.path(), garage.folder.path(), SigningKey::generate(), provenance);
  REQUIRE_FALSE(opened);
  CHECK(opened.error().code == "wrong_key");
}
