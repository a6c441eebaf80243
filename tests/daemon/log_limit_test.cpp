#include "dds/log_limit.hpp"

#include <memory>
#include <thread>
#include <vector>

#include "support/catch.hpp"

using namespace calib;
using namespace std::chrono_literals;

namespace {

struct Log {
  std::chrono::steady_clock::time_point now{1000s};
  std::vector<std::string> lines;
  std::vector<int> priorities;
  std::unique_ptr<LogLimit> limit = std::make_unique<LogLimit>(
      "Cyclone DDS", [this] { return now; },
      [this](int priority, const std::string& line) {
        lines.push_back(line);
        priorities.push_back(priority);
      });
};

}  // namespace

TEST_CASE("ten lines a minute are written, the others are counted and reported") {
  Log log;
  for (int i = 0; i < 1010; ++i) log.limit->log(4, "malformed packet " + std::to_string(i) + "\n");
  REQUIRE(log.lines.size() == 10);
  CHECK(log.lines[9] == "Cyclone DDS: malformed packet 9");
  log.now += 59s;
  log.limit->report_if_due();
  CHECK(log.lines.size() == 10);
  log.now += 1s;
  log.limit->report_if_due();
  REQUIRE(log.lines.size() == 11);
  CHECK(log.lines[10] == "Cyclone DDS: 1000 more messages in the last minute, the last: malformed packet 1009");
  log.limit->report_if_due();
  CHECK(log.lines.size() == 11);
}

TEST_CASE("the next minute begins with the next line, and reports the last one") {
  Log log;
  for (int i = 0; i < 12; ++i) log.limit->log(3, "a");
  log.now += 5min;
  log.limit->log(4, "b");
  REQUIRE(log.lines.size() == 12);
  CHECK(log.lines[10] == "Cyclone DDS: 2 more messages in the last minute, the last: a");
  CHECK(log.lines[11] == "Cyclone DDS: b");
  CHECK(log.priorities[9] == 3);
  CHECK(log.priorities[10] == 4);
}

TEST_CASE("few lines are written unchanged, and nothing is reported at the end") {
  Log log;
  for (int i = 0; i < 10; ++i) log.limit->log(4, "a");
  log.now += 2min;
  log.limit->report_if_due();
  log.limit.reset();
  CHECK(log.lines.size() == 10);
}

TEST_CASE("the count is reported at the end") {
  Log log;
  for (int i = 0; i < 15; ++i) log.limit->log(4, "a");
  log.limit.reset();
  REQUIRE(log.lines.size() == 11);
  CHECK(log.lines[10] == "Cyclone DDS: 5 more messages in the last minute, the last: a");
}

TEST_CASE("a message is one line of bounded length") {
  Log log;
  log.limit->log(4, "first\nsecond\n");
  log.limit->log(4, std::string(100'000, 'x'));
  CHECK(log.lines[0] == "Cyclone DDS: first");
  CHECK(log.lines[1].size() == std::string("Cyclone DDS: ").size() + LogLimit::longest_line);
}

TEST_CASE("lines of several threads are all counted") {
  std::vector<std::string> lines;
  std::mutex mutex;
  LogLimit limit("x", &std::chrono::steady_clock::now, [&](int, const std::string& line) {
    const std::lock_guard lock(mutex);
    lines.push_back(line);
  });
  std::vector<std::thread> threads;
  for (int i = 0; i < 4; ++i)
    threads.emplace_back([&] {
      for (int line = 0; line < 1000; ++line) limit.log(4, "a");
    });
  for (std::thread& thread : threads) thread.join();
  CHECK(lines.size() == 10);
}
