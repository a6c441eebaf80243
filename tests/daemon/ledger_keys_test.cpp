#include <sqlite3.h>

#include <fstream>
#include <nlohmann/json.hpp>

#include "ledger.hpp"
#include "support/catch.hpp"
#include "support/events.hpp"
#include "support/support.hpp"

using namespace calib;
using namespace std::chrono_literals;
using Catch::Matchers::ContainsSubstring;
using test::require_ok;

namespace {

constexpr Moment moment{1'700'000'000s, 42s};
const Provenance provenance{"car", std::string(64, 'c'), "1.2.3", std::string(64, 'd'), "boot"};

CalibrationRecord decided(Decision decision, double x_m) {
  CalibrationRecord record;
  record.decision = decision;
  record.asked_by = "calibd";
  record.reason = "a test";
  record.evidence_sha256 = std::string(64, 'e');
  record.T_camera_lidar.translation().x() = x_m;
  if (decision == Decision::baseline) record.baseline.emplace().pairs = 20;
  return record;
}

DriftAlert drifted() {
  DriftAlert alert;
  alert.stamp = moment.wall;
  alert.vehicle = "car";
  alert.pair = "front";
  alert.verdict = Verdict::drifted;
  alert.reason = "yaw";
  return alert;
}

/// Keys `a`, `b` and `c`, and a ledger that any of them may open.
struct Garage {
  Garage() {
    for (const char* name : {"a", "b", "c"}) require_ok(SigningKey::generate().save(file(name)));
  }
  [[nodiscard]] std::filesystem::path file(const std::string& name) const { return folder.path() / (name + ".key"); }
  [[nodiscard]] SigningKey key(const std::string& name) const { return require_ok(SigningKey::load(file(name))); }
  [[nodiscard]] std::string id(const std::string& name) const { return key(name).public_key().id_text(); }
  [[nodiscard]] Ledger open(const std::string& name, const std::optional<PublicKey>& trusted = {}) const {
    return require_ok(Ledger::open(folder.path(), folder.path(), key(name), provenance, {}, trusted));
  }
  [[nodiscard]] Ledger::NewKey next(const std::string& name, std::optional<std::uint64_t> doubted_from = {}) const {
    return {.key = key(name), .doubted_from = doubted_from, .asked_by = "uid:0", .comment = {"yearly", "uid:1000"}};
  }
  /// Records 1 and 2 of pairs front and rear, with a state each, and 3: a baseline.
  [[nodiscard]] Ledger begun() const {
    Ledger ledger = open("a");
    for (const char* pair : {"front", "rear"})
      REQUIRE(ledger.write(pair, state, {decided(Decision::initial, 1), {}}, moment));
    REQUIRE(ledger.write("front", state, {decided(Decision::baseline, 1), {}}, moment));
    return ledger;
  }
  [[nodiscard]] std::map<std::string_view, const PairState*> states() const {
    return {{"front", &state}, {"rear", &state}};
  }
  test::TemporaryFolder folder;
  PairState state = [] {
    PairState evaluated;
    evaluated.evaluated = 7;
    return evaluated;
  }();
};

}  // namespace

TEST_CASE("the next key signs after a change, and finds everything there at the next start") {
  const Garage garage;
  {
    Ledger ledger = garage.begun();
    const auto record = require_ok(ledger.change_key(garage.next("b"), garage.states(), moment));
    CHECK(record.sequence == 4);
    CHECK(record.reason == "key " + garage.id("b") + " replaces key " + garage.id("a"));
    CHECK((record.comment.text == "yearly" && record.comment.login == "uid:1000" && record.asked_by == "uid:0"));
    CHECK(ledger.key_id() == garage.id("b"));
    CHECK((ledger.key_id(4) == garage.id("a") && ledger.key_id(5) == garage.id("b")));
    CHECK_FALSE(ledger.signing_refused());
    REQUIRE(ledger.write("front", garage.state, {decided(Decision::rolled_back, 1), {}}, moment));
    CHECK(ledger.find("front", 1));
    CHECK(ledger.find("front", 5));
    CHECK(ledger.find("front", 4).error().code == "record_not_found");
  }
  const Ledger ledger = garage.open("b");
  CHECK_FALSE(ledger.signing_refused());
  CHECK_FALSE(ledger.records_missing());
  CHECK_FALSE(ledger.evidence_failure());
  CHECK(ledger.next_sequence() == 6);
  CHECK(ledger.history("front").in_force()->sequence == 5);
  CHECK(ledger.history("front").baseline()->sequence == 3);
  for (const char* pair : {"front", "rear"}) CHECK(require_ok(ledger.state(pair))->evaluated == 7);
  // A state of another pair, or of another key, is still none.
  CHECK_FALSE(garage.open("a").state("front"));
}

TEST_CASE("the fleet is told of another key by an event that this key has signed, and of what a lost one leaves open") {
  for (const bool lost : {false, true}) {
    const Garage garage;
    std::size_t before = 0;
    {
      Ledger ledger = garage.begun();
      before = ledger.waiting_event_count();
      if (!lost) REQUIRE(ledger.change_key(garage.next("b"), garage.states(), moment));
    }
    if (lost) {
      Ledger ledger = garage.open("b", garage.key("a").public_key());
      CHECK(ledger.waiting_event_count() == before);
      REQUIRE(ledger.change_key({.key = {}, .doubted_from = {}, .asked_by = "uid:0", .comment = {}}, garage.states(),
                                moment));
    }
    CHECK(garage.open("b").waiting_event_count() == before + (lost ? 2 : 1));  // opening it has nothing to add
    const auto store = require_ok(Store::open(garage.folder.path() / "calibd.db", Store::Mode::read_only));
    const auto events = require_ok(store.waiting_events(before, 10));
    const auto type = [&](std::size_t i) { return nlohmann::json::parse(events.at(i).json).at("type"); };
    if (lost) CHECK(type(0) == "calibd.store.trouble.v1");
    CHECK(type(lost ? 1 : 0) == "calibd.record.key_changed.v1");
    for (const Store::Event& event : events) CHECK(test::is_signed(event.json, garage.key("b").public_key()));
  }
}

TEST_CASE("the key before a change refuses to sign, watches on, and leaves everything as it is") {
  const Garage garage;
  const auto head = garage.folder.path() / "chain-head.json";
  REQUIRE(garage.begun().change_key(garage.next("b"), garage.states(), moment));
  const auto before = std::filesystem::last_write_time(head);
  {
    Ledger ledger = garage.open("a");
    REQUIRE(ledger.signing_refused());
    CHECK(*ledger.signing_refused() == "key " + garage.id("a") + " is not the chain's key " + garage.id("b") +
                                           ", which replaced it in record 4; put the secret key of that one in place, "
                                           "and restart calibd");
    CHECK(ledger.history("front").in_force()->sequence == 1);
    CHECK(ledger.history("front").baseline()->sequence == 3);
    for (const Decision decision :
         {Decision::accepted, Decision::proposed, Decision::rejected, Decision::rolled_back, Decision::baseline}) {
      const auto refused = ledger.write("front", garage.state, {decided(decision, 2), drifted()}, moment);
      REQUIRE_FALSE(refused);
      CHECK(refused.error().code == "wrong_key");
    }
    const std::uint64_t waiting = ledger.waiting_event_count();
    CHECK(require_ok(ledger.latest_alerts(8)).alerts.empty());
    // An alert on DDS needs no signature. The fleet could not verify it.
    const auto told = require_ok(ledger.write("front", garage.state, {{}, drifted()}, moment));
    CHECK(told.alert->alert_sequence == 1);
    CHECK(require_ok(ledger.latest_alerts(8)).alerts.size() == 1);
    CHECK(ledger.waiting_event_count() == waiting);
    CHECK(ledger.tell([](Feed&, const Feed::Writer&) { return Result<void>{}; }, moment).error().code == "wrong_key");
    CHECK(ledger.write_evidence(garage.states()));
    CHECK(ledger.change_key(garage.next("c"), garage.states(), moment).error().code == "wrong_key");
  }
  CHECK(std::filesystem::last_write_time(head) == before);
  const Ledger ledger = garage.open("b");
  CHECK_FALSE(ledger.records_missing());
  CHECK(ledger.next_sequence() == 5);
  CHECK(require_ok(ledger.state("front"))->evaluated == 7);
}

TEST_CASE("with a key that has signed nothing here, the records count if a trusted public key says so") {
  const Garage garage;
  (void)garage.begun();
  {
    Ledger ledger = garage.open("b", garage.key("a").public_key());
    CHECK_THAT(ledger.signing_refused().value(),
               ContainsSubstring("key " + garage.id("b") + " is not the chain's key " + garage.id("a")));
    CHECK_THAT(*ledger.signing_refused(), ContainsSubstring("calibctl rotate-key --lost"));
    CHECK(ledger.history("front").in_force()->sequence == 1);
    CHECK(ledger.find("front", 1));
  }
  for (const std::optional<PublicKey>& trusted :
       {std::optional<PublicKey>(), std::optional(garage.key("c").public_key())}) {
    Ledger ledger = garage.open("b", trusted);
    CHECK_THAT(ledger.signing_refused().value(), ContainsSubstring("do not verify with key " + garage.id("b")));
    CHECK(ledger.history("front").in_force() == nullptr);
    CHECK(ledger.find("front", 1).error().code == "wrong_key");
    CHECK(ledger.change_key({{}, {}, "uid:0", {}}, {}, moment).error().code == "wrong_key");
    // What the configuration says is watched without a record, and that is to be seen.
    const auto watched = require_ok(ledger.write("front", garage.state, {decided(Decision::initial, 5), {}}, moment));
    CHECK(watched.record->sequence == 0);
    CHECK(ledger.history("front").in_force()->T_camera_lidar.translation().x() == 5);
    CHECK(ledger.history("front").known_baseline(std::string(64, 'e')) == nullptr);
  }
  const Ledger ledger = garage.open("a");
  CHECK_FALSE(ledger.records_missing());
  CHECK(ledger.next_sequence() == 4);
}

TEST_CASE("a lost key is replaced by the one that is there, for who trusts that one") {
  const Garage garage;
  (void)garage.begun();
  const auto request = [&] { return Ledger::NewKey{{}, {}, "uid:0", {}}; };
  CHECK(garage.open("a").change_key(request(), garage.states(), moment).error().code == "bad_request");
  {
    Ledger ledger = garage.open("b", garage.key("a").public_key());
    // The configuration had a new extrinsic meanwhile.
    REQUIRE(ledger.write("front", garage.state, {decided(Decision::initial, 5), {}}, moment));
    const auto record = require_ok(ledger.change_key(request(), garage.states(), moment));
    CHECK_THAT(record.reason, Catch::Matchers::EndsWith("which is lost"));
    CHECK_FALSE(ledger.signing_refused());
    // It counts until it is signed, too.
    CHECK(ledger.history("front").in_force()->sequence == 0);
    REQUIRE(ledger.write("front", garage.state, {*ledger.history("front").in_force(), {}}, moment));
    CHECK(ledger.history("front").in_force()->sequence == 5);
    CHECK(ledger.history("front").before_in_force()->sequence == 1);
  }
  const Ledger ledger = garage.open("b");
  CHECK_FALSE(ledger.records_missing());
  CHECK_FALSE(ledger.signing_refused());
  CHECK(require_ok(ledger.state("rear"))->evaluated == 7);
  // The one that was lost is found again, and put in place.
  const Ledger found = garage.open("a", garage.key("a").public_key());
  CHECK_THAT(found.signing_refused().value(), ContainsSubstring("key " + garage.id("a") + " was lost"));
  CHECK(found.history("front").in_force() == nullptr);
  const Ledger told = garage.open("a", garage.key("b").public_key());
  CHECK(told.signing_refused());
  CHECK(told.history("front").in_force()->sequence == 5);
}

TEST_CASE("a lost key does not hide that records are missing") {
  const Garage garage;
  (void)garage.begun();
  sqlite3* database = nullptr;
  REQUIRE(sqlite3_open((garage.folder.path() / "calibd.db").c_str(), &database) == SQLITE_OK);
  REQUIRE(sqlite3_exec(database, "delete from record where sequence = 3", nullptr, nullptr, nullptr) == SQLITE_OK);
  sqlite3_close(database);
  Ledger ledger = garage.open("b", garage.key("a").public_key());
  const auto record = require_ok(ledger.change_key({{}, {}, "uid:0", {}}, garage.states(), moment));
  CHECK_THAT(record.reason, ContainsSubstring("records 3 to 3, which calibd had written, are missing"));
  CHECK(ledger.records_missing());
}

TEST_CASE("doubted records vouch for nothing: not for a baseline, and not for the extrinsic in force") {
  const Garage garage;
  {
    Ledger ledger = garage.begun();
    CHECK(ledger.change_key(garage.next("b", 4), garage.states(), moment).error().code == "bad_request");
    CHECK(ledger.change_key(garage.next("b", 0), garage.states(), moment).error().code == "bad_request");
    REQUIRE(ledger.change_key(garage.next("b", 2), garage.states(), moment));
    CHECK(ledger.history("front").baseline() == nullptr);
  }
  const Ledger ledger = garage.open("b");
  CHECK(ledger.history("front").baseline() == nullptr);
  CHECK(ledger.history("front").in_force()->sequence == 1);
  CHECK(ledger.history("front").doubted.empty());
  CHECK(ledger.history("rear").in_force()->sequence == 2);
  CHECK(ledger.history("rear").doubted.contains(2));
}

TEST_CASE("a key that was there before does not come back") {
  const Garage garage;
  Ledger ledger = garage.begun();
  CHECK(ledger.change_key(garage.next("a"), garage.states(), moment).error().code == "bad_request");
  REQUIRE(ledger.change_key(garage.next("b"), garage.states(), moment));
  CHECK(ledger.change_key(garage.next("a"), garage.states(), moment).error().code == "bad_request");
  REQUIRE(ledger.change_key(garage.next("c"), garage.states(), moment));
  CHECK_FALSE(garage.open("c").signing_refused());
  CHECK(garage.open("a").signing_refused());
  CHECK(garage.open("b").signing_refused());
}

TEST_CASE("a crash at any moment of a change leaves a chain that one of the keys opens, with nothing missing") {
  const Garage garage;
  const auto head = garage.folder.path() / "chain-head.json", kept = garage.folder.path() / "kept";
  (void)garage.begun();
  // Before the record: the head is for both keys.
  SigningKey a = garage.key("a"), b = garage.key("b");
  const auto noted = require_ok(read_chain_head(garage.folder.path(), &a));
  REQUIRE(write_chain_head(garage.folder.path(), *noted, a, &b));
  std::filesystem::copy_file(head, kept);
  CHECK_FALSE(garage.open("a").records_missing());
  REQUIRE(garage.open("a").change_key(garage.next("b"), garage.states(), moment));
  // After the record, before the head.
  std::filesystem::copy_file(kept, head, std::filesystem::copy_options::overwrite_existing);
  const Ledger ledger = garage.open("b");
  CHECK_FALSE(ledger.records_missing());
  CHECK_FALSE(ledger.signing_refused());
}

TEST_CASE("a change that cannot be written changes nothing") {
  const Garage garage;
  const auto head_dir = garage.folder.path() / "head";
  const auto open = [&](const std::string& name) {
    return require_ok(Ledger::open(garage.folder.path(), head_dir, garage.key(name), provenance));
  };
  Ledger ledger = open("a");
  REQUIRE(ledger.write("front", garage.state, {decided(Decision::initial, 1), {}}, moment));
  CHECK(ledger.change_key(garage.next("b"), {{"front", &garage.state}}, moment).error().code == "store_failed");
  CHECK(ledger.key_id() == garage.id("a"));
  CHECK(ledger.next_sequence() == 2);
  std::filesystem::create_directory(head_dir);
  CHECK(ledger.change_key(garage.next("b"), {{"front", &garage.state}}, moment));
}

TEST_CASE("a ledger in which a second key has signed without a change of keys does not open") {
  const Garage garage;
  (void)garage.begun();
  auto store = require_ok(Store::open(garage.folder.path() / "calibd.db", Store::Mode::read_write));
  CalibrationRecord record = decided(Decision::accepted, 2);
  record.vehicle = "car";
  record.pair = "front";
  record.sequence = 4;
  record.previous_sha256 = sha256_hex(require_ok(store.record(3)).canonical);
  record.configuration_sha256 = record.software_sha256 = std::string(64, 'a');
  REQUIRE(store.in_transaction(
      [&] { return store.append_record(4, "front", require_ok(sign_record(record, garage.key("b")))); }));
  const auto opened = Ledger::open(garage.folder.path(), garage.folder.path(), garage.key("a"), provenance);
  REQUIRE_FALSE(opened);
  CHECK(opened.error().code == "wrong_key");
  CHECK_THAT(opened.error().context, ContainsSubstring("record 4 does not verify"));
}
