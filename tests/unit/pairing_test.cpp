#include "calib/pairing.hpp"

#include <algorithm>
#include <random>

#include "support/catch.hpp"

using namespace calib;
using namespace std::chrono_literals;

namespace {

Image image_at(Timestamp stamp) { return {stamp, 1, 1, {0}}; }
LidarScan scan_at(Timestamp stamp) { return {stamp, {{1, 2, 3, 0}}}; }

}  // namespace

TEST_CASE("whatever the order of arrival, the pair nearest in time comes out") {
  // Camera at 10 Hz, LiDAR a little slower: the differences are 30, 21, 12, 3 and 6 ms.
  std::vector<std::pair<char, Timestamp>> arrivals;
  for (int i = 0; i < 5; ++i) {
    arrivals.emplace_back('i', i * 100ms);
    arrivals.emplace_back('r', i * 100ms + 1ms);
    arrivals.emplace_back('s', i * 109ms - 30ms);
  }
  std::mt19937 random(1);
  for (int trial = 0; trial < 2000; ++trial) {
    std::ranges::shuffle(arrivals, random);
    PairBuffer buffer(40ms, {.right_image = true});
    for (const auto& [kind, stamp] : arrivals)
      kind == 'i'   ? buffer.add_image(image_at(stamp))
      : kind == 'r' ? buffer.add_right_image(image_at(stamp))
                    : buffer.add_scan(scan_at(stamp));
    const auto pair = buffer.take();
    REQUIRE(pair);
    REQUIRE(pair->image.stamp == 300ms);
    REQUIRE(pair->right_image->stamp == 301ms);
    REQUIRE(pair->scan.stamp == 297ms);
    REQUIRE(pair->time_difference() == -3ms);
    REQUIRE(pair->scan.points.size() == 1);
    // What is left is younger than what was taken: one more pair, then none.
    const auto next = buffer.take();
    REQUIRE(next);
    REQUIRE(next->image.stamp == 400ms);
    REQUIRE_FALSE(buffer.take());
  }
}

TEST_CASE("swapping which sensor is early changes the sign of the difference and nothing else") {
  for (const auto lead : {0ms, 7ms, 25ms}) {
    PairBuffer a(25ms, {}), b(25ms, {});
    a.add_image(image_at(1s));
    a.add_scan(scan_at(1s + lead));
    b.add_image(image_at(1s + lead));
    b.add_scan(scan_at(1s));
    const auto from_a = a.take(), from_b = b.take();
    REQUIRE((from_a && from_b));
    CHECK(from_a->time_difference() == -from_b->time_difference());
  }
}

TEST_CASE("the tolerance belongs to the pairs, and a nanosecond more does not") {
  for (const bool within : {true, false}) {
    PairBuffer buffer(25ms, {});
    buffer.add_image(image_at(1s));
    buffer.add_scan(scan_at(1s + 25ms + (within ? 0ns : 1ns)));
    CHECK(buffer.take().has_value() == within);
  }
}

TEST_CASE("a sensor that runs on alone costs no memory: only its latest samples can still be paired") {
  PairBuffer buffer(1ms, {});
  for (int i = 0; i < 1000; ++i) buffer.add_image(image_at(i * 100ms));
  PairBuffer old = buffer;
  old.add_scan(scan_at(900 * 100ms));
  CHECK_FALSE(old.take());
  buffer.add_scan(scan_at(998 * 100ms));
  REQUIRE(buffer.take());
  buffer.add_scan(scan_at(999 * 100ms));
  CHECK(buffer.take());
}

TEST_CASE("why there is no pair names the sensor that is to blame") {
  const auto says = [](const PairBuffer& buffer, const char* code, const char* word) {
    const Error error = buffer.why_none();
    CHECK(error.code == code);
    CHECK_THAT(error.context, Catch::Matchers::ContainsSubstring(word));
  };
  PairBuffer buffer(25ms, {.right_image = true});
  says(buffer, "sensor_silent", "camera");
  buffer.add_image(image_at(1s));
  says(buffer, "sensor_silent", "LiDAR");
  buffer.add_scan(scan_at(1100ms));
  says(buffer, "right_image_missing", "right camera");
  buffer.add_right_image(image_at(1s));
  says(buffer, "time_difference", "100 ms");
  buffer.add_image(image_at(1110ms));
  CHECK_FALSE(buffer.take());
  says(buffer, "right_image_missing", "triggered together");
  buffer.add_right_image(image_at(1115ms));
  CHECK(buffer.take());
}

TEST_CASE("an empty buffer gives no pair") {
  CHECK_FALSE(PairBuffer(1s, {}).take());
  CHECK_FALSE(PairBuffer(1s, {.right_image = true}).take());
}

TEST_CASE("depth is paired with the image of its own stamp; missing depth is named") {
  const auto says = [](const PairBuffer& buffer, const char* word) {
    CHECK(buffer.why_none().code == "depth_missing");
    CHECK_THAT(buffer.why_none().context, Catch::Matchers::ContainsSubstring(word));
  };
  PairBuffer buffer(25ms, {.depth = true});
  buffer.add_image(image_at(1s));
  buffer.add_scan(scan_at(1s));
  says(buffer, "no depth arrived");
  buffer.add_depth({1006ms, 1, 1, {6}});
  CHECK_FALSE(buffer.take());
  says(buffer, "stamp of an image");
  buffer.add_depth({1005ms, 1, 1, {5}});
  const auto pair = buffer.take();
  REQUIRE(pair);
  CHECK(pair->depth->inverse_depth == std::vector<float>{5});
  buffer.add_image(image_at(1006ms));
  buffer.add_scan(scan_at(1006ms));
  const auto next = buffer.take();  // what is younger than the image taken is still there
  REQUIRE(next);
  CHECK(next->depth->stamp == 1006ms);
}

TEST_CASE("a pair's turn rate is the largest from the sample before its first stamp to the one after its last") {
  for (const auto lead : {30ms, -30ms, 0ms}) {
    PairBuffer buffer(50ms, {.turn_rate = true});
    buffer.add_image(image_at(1s));
    buffer.add_scan(scan_at(1s + lead));
    const auto from = std::min(1s + 0ms, 1s + lead), to = std::max(1s + 0ms, 1s + lead);
    buffer.add_turn_rate({from - 100ms, 9});  // not the last one before
    buffer.add_turn_rate({to + 150ms, 0.3});
    buffer.add_turn_rate({from - 20ms, 0.2});
    buffer.add_turn_rate({(from + to) / 2, lead == 0ms ? 0.1 : 0.4});
    buffer.add_turn_rate({to + 200ms, 9});  // not the first one after
    const auto pair = buffer.take();
    REQUIRE(pair);
    CHECK(*pair->turn_rate_rad_s == (lead == 0ms ? 0.1 : 0.4));
  }
}

TEST_CASE("a pair waits for the turn rates around it, and not for those of others") {
  const auto says = [](const PairBuffer& buffer, const char* word) {
    CHECK(buffer.why_none().code == "motion_unknown");
    CHECK_THAT(buffer.why_none().context, Catch::Matchers::ContainsSubstring(word));
  };
  PairBuffer buffer(50ms, {.turn_rate = true});
  buffer.add_image(image_at(1s));
  buffer.add_scan(scan_at(1040ms));
  CHECK_FALSE(buffer.take());
  says(buffer, "no turn rate arrived");
  buffer.add_turn_rate({1s - 151ms, 0.1});  // too old
  buffer.add_turn_rate({1040ms + 10ms, 0.1});
  CHECK_FALSE(buffer.take());
  says(buffer, "150 ms");
  PairBuffer without_after(50ms, {.turn_rate = true});
  without_after.add_image(image_at(1s));
  without_after.add_scan(scan_at(1040ms));
  without_after.add_turn_rate({990ms, 0.1});
  without_after.add_turn_rate({1039ms, 0.1});
  CHECK_FALSE(without_after.take());
  without_after.add_turn_rate({1191ms, 0.1});  // too late
  CHECK_FALSE(without_after.take());
  // A later pair is not held up by the one that will never be known.
  buffer.add_image(image_at(1060ms));
  buffer.add_scan(scan_at(1065ms));
  buffer.add_turn_rate({1070ms, 0.2});
  const auto pair = buffer.take();
  REQUIRE(pair);
  CHECK(pair->image.stamp == 1060ms);
  CHECK(*pair->turn_rate_rad_s == 0.2);
}

TEST_CASE("turn rates that nobody asked for are no reason to wait") {
  PairBuffer buffer(50ms, {});
  buffer.add_image(image_at(1s));
  buffer.add_scan(scan_at(1s));
  const auto pair = buffer.take();
  REQUIRE(pair);
  CHECK_FALSE(pair->turn_rate_rad_s);
}

TEST_CASE("an IMU that runs on alone costs no memory: only its latest samples are known") {
  PairBuffer buffer(1ms, {.turn_rate = true});
  for (int i = 0; i < 10000; ++i) buffer.add_turn_rate({i * 1ms, 0.1});
  buffer.add_image(image_at(7s));
  buffer.add_scan(scan_at(7s));
  CHECK_FALSE(buffer.take());
  buffer.add_image(image_at(8s));
  buffer.add_scan(scan_at(8s));
  CHECK(buffer.take());
}
