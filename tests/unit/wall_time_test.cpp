#include "calib/wall_time.hpp"

#include <random>

#include "support/catch.hpp"
#include "support/support.hpp"

using namespace calib;
using namespace calib::test;
using namespace std::chrono_literals;

TEST_CASE("a time is written as RFC 3339, rounded down to milliseconds") {
  CHECK(rfc3339(0ns) == "1970-01-01T00:00:00.000Z");
  CHECK(rfc3339(1769860800s + 999'999'999ns) == "2026-01-31T12:00:00.999Z");
  CHECK(rfc3339(951'782'400s) == "2000-02-29T00:00:00.000Z");
  CHECK(rfc3339(-1ns) == "1969-12-31T23:59:59.999Z");
}

TEST_CASE("a time is written with nine decimals where it must be read back exactly") {
  CHECK(rfc3339_ns(0ns) == "1970-01-01T00:00:00.000000000Z");
  CHECK(rfc3339_ns(-1ns) == "1969-12-31T23:59:59.999999999Z");
}

TEST_CASE("a time is read with any number of decimals up to nine") {
  CHECK(require_ok(parse_rfc3339("2000-02-29T00:00:00Z")) == 951'782'400s);
  CHECK(require_ok(parse_rfc3339("1970-01-01T00:00:00.5Z")) == 500ms);
  CHECK(require_ok(parse_rfc3339("1970-01-01T00:00:01.000000001Z")) == 1s + 1ns);
}

TEST_CASE("any time from 1678 to 2261 comes back from its text") {
  std::mt19937_64 random(4);
  for (int i = 0; i < 20'000; ++i) {
    const WallTime time(static_cast<std::int64_t>(random()) / 1'000 * 995);
    CHECK(require_ok(parse_rfc3339(rfc3339_ns(time))) == time);
  }
}

TEST_CASE("a text that is no time in UTC is refused") {
  for (const char* text : {"", "Z", "2026-01-31", "2026-01-31T12:00:00", "2026-01-31 12:00:00Z", "2026-02-30T12:00:00Z",
                           "2026-01-31T24:00:00Z", "2026-01-31T12:60:00Z", "2026-01-31T12:00:61Z",
                           "2026-01-31T12:00:00.Z", "2026-01-31T12:00:00.1234567890Z", "2026-01-31T12:00:00,5Z",
                           "2026-01-31T12:00:00+00:00", "0000-01-31T12:00:00Z", "9999-01-31T12:00:00Z",
                           "2026-01-31T12:00:-1Z", "2026-01-31T12:00:00.-5Z", "2026-01-31T12:00: 0Z"}) {
    INFO(text);
    CHECK_FALSE(parse_rfc3339(text));
  }
}
