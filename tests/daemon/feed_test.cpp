#include "feed.hpp"

#include <set>

#include "support/catch.hpp"
#include "support/events.hpp"
#include "support/store_fixture.hpp"

using namespace calib;
using namespace calib::test;
using namespace std::chrono_literals;
using nlohmann::json;

namespace {

constexpr WallTime start = 1'800'000'000s;

struct FeedFixture : StoreFixture {
  Store store = open();
  Feed feed{FeedSettings{}};
  WallTime now = start;
  std::uint64_t alerts = 0;

  template <typename Tell>
  void in_transaction(Tell tell) {
    require_ok(store.in_transaction([&] { return tell(Feed::Writer{store, key, "car", now}); }));
  }
  [[nodiscard]] DriftAlert alert_of(Verdict verdict, const std::string& pair = "front") {
    DriftAlert alert{.stamp = now, .alert_sequence = ++alerts, .vehicle = "car", .pair = pair, .verdict = verdict};
    alert.reason = "yaw";
    alert.misalignment.sigma.setConstant(std::numeric_limits<double>::infinity());
    alert.record_sequence = 1;
    return alert;
  }
  void say(Verdict verdict, const std::string& pair = "front") {
    in_transaction([&](const auto& writer) { return feed.tell(writer, alert_of(verdict, pair)); });
  }
  void pass(std::chrono::nanoseconds time) {
    now += time;
    if (feed.held_is_due(now)) in_transaction([&](const auto& writer) { return feed.tell_held(writer); });
  }
  [[nodiscard]] std::vector<json> events() const {
    std::vector<json> all;
    for (const Store::Event& event : require_ok(store.waiting_events(0, 10'000)))
      all.push_back(json::parse(event.json));
    return all;
  }
  /// `suspected confirmed`
  [[nodiscard]] std::string told() const {
    std::string words;
    for (const json& event : events()) {
      const std::string type = event["type"];
      const auto begin = type.find('.', type.find('.') + 1) + 1;
      words += (words.empty() ? "" : " ") + type.substr(begin, type.rfind('.') - begin);
    }
    return words;
  }
  void start_again() {
    feed = Feed(FeedSettings{});
    in_transaction([&](const auto& writer) { return feed.restore(writer); });
  }
};

}  // namespace

TEST_CASE_METHOD(FeedFixture, "an event is CloudEvents JSON, signed, and names its place in the feed") {
  const auto chain = random_chain(random, 1, key);
  in_transaction([&](const auto& writer) -> Result<void> {
    require_ok(store.append_record(1, "front", chain[0]));
    return feed.tell(writer, require_ok(parse_record(chain[0].canonical)), chain[0]);
  });
  say(Verdict::suspect);
  const auto rows = require_ok(store.waiting_events(0, 10));
  REQUIRE(rows.size() == 2);
  for (const Store::Event& row : rows) {
    CHECK(test::is_signed(row.json, key.public_key()));
    CHECK_FALSE(test::is_signed(row.json, SigningKey::generate().public_key()));
    std::string forged = row.json;
    forged.replace(forged.find("car-"), 4, "cat-");
    CHECK_FALSE(test::is_signed(forged, key.public_key()));
    CHECK(row.json.size() <= Store::max_event_bytes);
  }
  const json event = json::parse(rows[1].json);
  CHECK(event["specversion"] == "1.0");
  CHECK(event["id"] == "car-2");
  CHECK(event["source"] == "/calibd/car");
  CHECK(event["type"] == "calibd.drift.suspected.v1");
  CHECK(event["subject"] == "front");
  CHECK(event["time"] == rfc3339(start));
  CHECK(event["data"]["sequence"] == 2);
  CHECK(event["data"]["previous"] == 1);
  CHECK(event["data"]["record"]["sequence"] == 1);
  CHECK(event["data"]["record"]["sha256"] == sha256_hex(chain[0].canonical));
  const std::string signature = event["data"]["record"]["signature"];
  CHECK(chain[0].signature.find('\n' + signature + '\n') != std::string::npos);
}

TEST_CASE_METHOD(FeedFixture, "what was told is not told again, and silence changes nothing") {
  say(Verdict::calibrated);
  CHECK(told().empty());  // there was nothing to be cleared
  say(Verdict::drifted);
  for (int i = 0; i < 3; ++i) {  // three starts
    start_again();
    now += 24h;
    say(Verdict::not_evaluated);
    say(Verdict::drifted);
  }
  CHECK(told() == "confirmed");
  now += 1h;
  say(Verdict::calibrated);
  now += 1h;
  say(Verdict::calibrated);
  CHECK(told() == "confirmed cleared");
}

TEST_CASE_METHOD(FeedFixture, "a verdict that flaps is told once in ten minutes, as it is then") {
  for (int i = 0; i < 6; ++i) {
    say(i % 2 == 0 ? Verdict::suspect : Verdict::calibrated);
    pass(1min);
  }
  CHECK(told() == "suspected");
  say(Verdict::suspect);  // as it was told: nothing is to be said
  pass(1h);
  CHECK(told() == "suspected");
  say(Verdict::calibrated);
  CHECK(told() == "suspected cleared");
  CHECK(events().back()["data"]["changes_held"] == 6);
  pass(1min);
  const WallTime changed = now;
  say(Verdict::suspect);
  SECTION("in one run") {}
  SECTION("also when calibd is started again") { start_again(); }
  SECTION("also when the clock is set back") { now -= 24h; }
  pass(1s);
  if (now > changed) {
    CHECK(told() == "suspected cleared");
    pass(10min);
  }
  CHECK(told() == "suspected cleared suspected");
  CHECK(events().back()["time"] == rfc3339(changed));
  CHECK_FALSE(events().back()["data"].contains("changes_held"));
}

TEST_CASE_METHOD(FeedFixture, "confirmed drift is never held, and each pair is held for itself") {
  say(Verdict::suspect);
  say(Verdict::suspect, "rear");
  say(Verdict::drifted);
  CHECK(told() == "suspected suspected confirmed");
  say(Verdict::calibrated);
  say(Verdict::drifted);
  pass(1h);
  CHECK(told() == "suspected suspected confirmed");
}

TEST_CASE_METHOD(FeedFixture, "a pair without a verdict is told once, after what was held") {
  say(Verdict::drifted);
  now += 1s;
  say(Verdict::calibrated);
  CHECK_FALSE(feed.unavailable_is_due("front", 1h));
  REQUIRE(feed.unavailable_is_due("front", 2h));
  in_transaction([&](const auto& writer) { return feed.tell_unavailable(writer, alert_of(Verdict::not_evaluated)); });
  CHECK(told() == "confirmed cleared unavailable");
  CHECK_FALSE(feed.unavailable_is_due("front", 3h));
  CHECK(feed.unavailable_is_due("rear", 3h));
  now += 1h;
  say(Verdict::calibrated);
  CHECK(told() == "confirmed cleared unavailable cleared");
}

TEST_CASE_METHOD(FeedFixture,
                 "only the latest state waits, and the chain of the other events does not miss those before") {
  Status status;
  status.version = "1.2.3";
  status.pairs.resize(16);
  for (PairStatus& pair : status.pairs) {
    pair.name = std::string(64, 'p');
    pair.last_evaluated = now;
    pair.misalignment.emplace();
  }
  say(Verdict::suspect);
  for (int day = 0; day < 30; ++day) {
    REQUIRE(feed.state_is_due(now));
    in_transaction([&](const auto& writer) { return feed.tell_state(writer, status); });
    CHECK_FALSE(feed.state_is_due(now + 23h));
    now += 24h;
  }
  say(Verdict::drifted);
  CHECK(told() == "suspected state confirmed");
  const auto all = events();
  CHECK(all[1]["data"]["previous"] == 1);
  CHECK(all[1]["data"]["pairs_left_out"].get<int>() > 0);
  CHECK(all[1]["data"]["sequence"] == 31);
  CHECK(all[2]["data"]["sequence"] == 32);
  CHECK(all[2]["data"]["previous"] == 1);
  for (const Store::Event& row : require_ok(store.waiting_events(0, 9))) CHECK(row.json.size() <= 2000);
}

TEST_CASE_METHOD(FeedFixture, "of a state everything is told where it fits") {
  Status status;
  status.pairs.resize(2);
  status.pairs[0].name = "front";
  status.pairs[0].misalignment.emplace().delta[2] = 0.0123456789;
  in_transaction([&](const auto& writer) { return feed.tell_state(writer, status); });
  const json data = events().at(0)["data"];
  CHECK_FALSE(data.contains("pairs_left_out"));
  CHECK(data["pairs"][0]["name"] == "front");
  CHECK(data["pairs"][0]["verdict"] == "not_evaluated");
  CHECK(data["pairs"][0]["estimate"]["rotation_rad"] == json{0.0, 0.0, 0.012346});
}

TEST_CASE_METHOD(FeedFixture,
                 "a reason of any length and kind leaves an event that is short enough, signed and readable") {
  const std::string reason = GENERATE(as<std::string>(), std::string(100'000, 'x'), std::string(5'000, '\x01'),
                                      std::string(5'000, '\xff'), "Gr\xc3\xbc\xc3\x9f" + std::string(3'000, '"'), "");
  DriftAlert alert = alert_of(Verdict::drifted, std::string(64, 'p'));
  alert.reason = reason;
  alert.misalignment.delta.setConstant(-1.234567);
  alert.misalignment.sigma.setConstant(1e-5);
  in_transaction([&](const auto& writer) {
    return feed.tell(Feed::Writer{writer.store, writer.key, std::string_view("car"), writer.now}, alert);
  });
  const std::string text = require_ok(store.waiting_events(0, 1)).at(0).json;
  CHECK(text.size() <= Store::max_event_bytes);
  CHECK((reason.size() < 2'000 || text.size() > 1'900));
  CHECK(test::is_signed(text, key.public_key()));
}

TEST_CASE_METHOD(FeedFixture, "trouble is told once, and again when it comes back") {
  const auto trouble = [&](const std::string& what) {
    if (feed.is_news(what)) in_transaction([&](const auto& writer) { return feed.tell_trouble(writer, what); });
  };
  trouble("");
  trouble("records 1 to 2 are missing");
  start_again();
  trouble("records 1 to 2 are missing");
  CHECK(told() == "trouble");
  trouble("");
  trouble("records 1 to 2 are missing");
  CHECK(told() == "trouble trouble");
}

TEST_CASE_METHOD(FeedFixture, "a full outbox loses the oldest and says which", "[release-only]") {
  in_transaction([&](const auto& writer) -> Result<void> {
    for (std::uint64_t i = 0; i < 3 * Store::max_waiting_events; ++i)
      if (auto told = feed.tell_trouble(writer, "trouble " + std::to_string(i)); !told) return told;
    return {};
  });
  const auto rows = require_ok(store.waiting_events(0, 10'000));
  CHECK(rows.size() <= Store::max_waiting_events);
  CHECK(rows.size() > Store::max_waiting_events - 2 * Feed::dropped_at_once);
  // What waits and what is said to be lost make up all that was ever written.
  std::set<std::uint64_t> known;
  std::uint64_t previous = 0;
  for (const Store::Event& row : rows) {
    known.insert(row.sequence);
    const json data = json::parse(row.json)["data"];
    if (previous != 0) CHECK(data["previous"] == previous);
    previous = row.sequence;
    if (row.priority == Store::Priority::gap)
      for (std::uint64_t lost = data["from"]; lost <= data["to"]; ++lost) known.insert(lost);
  }
  CHECK(known.size() == previous);
  CHECK(*known.rbegin() == previous);
}

TEST_CASE_METHOD(FeedFixture,
                 "thirty days offline with a pair that flaps at its worst fit, and keep each confirmed drift",
                 "[release-only]") {
  std::size_t confirmed = 0, flaps = 0;
  for (int hour = 0; hour < 30 * 24; ++hour) {
    if (hour % 24 == 0) in_transaction([&](const auto& writer) { return feed.tell_state(writer, Status{}); });
    for (int i = 0; i < 12; ++i, ++flaps) {
      say(i % 2 == 0 ? Verdict::suspect : Verdict::calibrated);
      pass(5min);
    }
  }
  say(Verdict::drifted);
  for (const json& event : events()) confirmed += event["type"] == "calibd.drift.confirmed.v1";
  CHECK(confirmed == 1);
  CHECK(told().find("gap") == std::string::npos);
  CHECK(require_ok(store.waiting_event_count()) < flaps);
  { const Store closed = std::move(store); }
  CHECK(std::filesystem::file_size(file) < 10'000'000);
}

TEST_CASE_METHOD(FeedFixture, "who edits what was told does not hide the loss of an event") {
  say(Verdict::drifted);
  const std::string memory = *require_ok(store.feed_memory());
  require_ok(store.save_feed_memory(std::string(memory).replace(memory.find("\"last\":1"), 8, "\"last\":7")));
  start_again();
  CHECK(told() == "confirmed trouble");
  CHECK(events()[1]["data"]["previous"] == 0);
}

TEST_CASE_METHOD(FeedFixture, "who deletes what was told gets nothing signed") {
  say(Verdict::drifted);
  tamper("DELETE FROM feed; DELETE FROM outbox; INSERT INTO outbox VALUES(2, 0, 0, '" +
         alert_text(alert_of(Verdict::calibrated)) + "')");
  start_again();
  CHECK(told().find("cleared") == std::string::npos);
  CHECK(told().find("trouble") != std::string::npos);
  tamper("DELETE FROM feed; DELETE FROM outbox");
  start_again();
  CHECK(told() == "trouble");
}

TEST_CASE_METHOD(FeedFixture, "alerts that an earlier version left in the outbox become events in their places") {
  for (std::uint64_t i = 5; i <= 7; ++i) {
    tamper("INSERT INTO outbox VALUES(" + std::to_string(i) + ", 0, 0, '" +
           (i == 6 ? "spoilt" : alert_text(alert_of(i == 5 ? Verdict::suspect : Verdict::drifted))) + "')");
  }
  start_again();
  CHECK(told() == "suspected trouble confirmed gap");
  const auto all = events();
  CHECK(all[0]["id"] == "car-5");
  CHECK(all[2]["data"]["previous"] == 6);
  CHECK((all[3]["data"]["from"] == 1 && all[3]["data"]["to"] == 4));
  for (const Store::Event& row : require_ok(store.waiting_events(0, 9)))
    CHECK(test::is_signed(row.json, key.public_key()));
  start_again();
  CHECK(told() == "suspected trouble confirmed gap");
  say(Verdict::drifted);
  CHECK(events().size() == 4);
}
