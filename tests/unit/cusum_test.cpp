#include "calib/cusum.hpp"

#include <algorithm>
#include <limits>

#include "support/catch.hpp"
#include "vehicle/random.hpp"

using namespace calib;
using namespace std::chrono_literals;

namespace {

constexpr double limit = 10;

TEST_CASE("a CUSUM adds what lies above its reference value, and never falls below zero") {
  Cusum chart;
  chart.update(-5, 1s, limit);
  CHECK(chart.sum == 0);
  chart.update(1, 2s, limit);
  chart.update(2, 3s, limit);
  chart.update(-0.5, 4s, limit);
  CHECK(chart.sum == Approx(2.5));
  CHECK(chart.share(limit) == Approx(0.25));
  chart.update(-100, 5s, limit);
  CHECK(chart.sum == 0);
}

TEST_CASE("the onset is the stamp of the first pair of the run") {
  Cusum chart;
  chart.update(-1, 1s, limit);
  chart.update(1, 2s, limit);
  chart.update(1, 3s, limit);
  CHECK(chart.onset == 2s);
  chart.update(-5, 4s, limit);  // ends the run
  chart.update(1, 5s, limit);
  CHECK(chart.onset == 5s);
}

TEST_CASE("two values, however large, give no alarm; three do") {
  Cusum chart;
  for (const auto stamp : {1s, 2s}) chart.update(std::numeric_limits<double>::infinity(), stamp, limit);
  CHECK(chart.share(limit) < 1);
  chart.update(1e9, 3s, limit);
  CHECK(chart.share(limit) >= 1);
}

TEST_CASE("a CUSUM is capped, so that a long shift clears as soon as a short one") {
  Cusum chart;
  for (int i = 0; i < 1000; ++i) chart.update(1, 1s * i, limit);
  CHECK(chart.share(limit) == Approx(Cusum::cap_share));
  CHECK(chart.onset == 0s);
  int values = 0;
  for (; chart.share(limit) >= 1; ++values) chart.update(-1, 1000s, limit);
  CHECK(values <= 3);
}

TEST_CASE("by chance a CUSUM gives an alarm about once in its average run length") {
  constexpr double run_length = 500;
  for (const double k : {0.6, 1.5}) {
    const double of_chance = cusum_limit(k, run_length);
    vehicle::Random random(17);
    constexpr int values = 400'000;
    int alarms = 0;
    Cusum chart;
    for (int i = 0; i < values; ++i) {
      // Without the bound on an update, which at so low a limit would matter.
      const double sum = std::max(0.0, chart.sum + random.gaussian() - k);
      chart.sum = sum;
      if (chart.share(of_chance) >= 1) ++alarms, chart = {};
    }
    CAPTURE(k, alarms);
    CHECK(alarms > 0.8 * values / run_length);
    CHECK(alarms < 1.25 * values / run_length);
  }
  CHECK(cusum_limit(1.5, 1e8) > cusum_limit(1.5, 1e6));
}

}  // namespace
