// What is written to the disk, how often, and what a crash or a power cut may cost: a minute of evidence, no decision.
#include <sqlite3.h>
#include <sys/stat.h>

#include <algorithm>
#include <array>
#include <map>

#include "support/catch.hpp"
#include "support/pair_scenario.hpp"

using namespace calib;
using namespace calib::test;
using Catch::Matchers::ContainsSubstring;
using Catch::Matchers::EndsWith;
using Catch::Matchers::StartsWith;

namespace {

/// A minute of windows: what may wait to be written.
constexpr std::uint64_t minute_of_windows = 6;

/// What is written while it looks: transactions of the store, and files of evidence.
class Writes {
 public:
  explicit Writes(const PairScenario& scenario) : folder_(scenario.folder()) {
    sqlite3_open_v2((scenario.folder() / "calibd.db").c_str(), &store_, SQLITE_OPEN_READONLY, nullptr);
    look();
    transactions = files = 0;
    bytes = 0;
  }
  Writes(const Writes&) = delete;
  Writes& operator=(const Writes&) = delete;
  ~Writes() { sqlite3_close(store_); }

  void look() {
    const int version = store_version();
    transactions += std::exchange(version_, version) != version;
    for (const char* name : {"evidence-0", "evidence-1"}) {
      struct stat about {};
      if (::stat((folder_ / name).c_str(), &about) != 0) continue;
      const auto written = std::pair(about.st_mtim.tv_sec, about.st_mtim.tv_nsec);
      if (std::exchange(written_[name], written) == written) continue;
      ++files;
      bytes += static_cast<std::uint64_t>(about.st_size);
    }
  }
  int transactions = 0, files = 0;
  std::uint64_t bytes = 0;

 private:
  /// Another number after each transaction of another connection that wrote something.
  int store_version() {
    int version = 0;
    const auto read = [](void* into, int, char** values, char**) {
      *static_cast<int*>(into) = std::atoi(values[0]);
      return 0;
    };
    if (sqlite3_exec(store_, "PRAGMA data_version", read, &version, nullptr) != SQLITE_OK)
      throw std::runtime_error(sqlite3_errmsg(store_));
    return version;
  }

  std::filesystem::path folder_;
  sqlite3* store_ = nullptr;
  int version_ = 0;
  std::map<std::string, std::pair<time_t, long>> written_;
};

/// What is saved of the evidence alone: the drift monitor's state.
std::string evidence(const PairScenario& scenario) {
  PairState only;
  only.drift = scenario.state().drift;
  return to_text(only);
}

/// How often the journal says that evidence could not be read.
auto told(const PairScenario& scenario) {
  return std::ranges::count_if(scenario.journal(), [](const std::string& line) {
    return line.find("was not written by calibd with this signing key, or not completely; calibd goes on") !=
           std::string::npos;
  });
}

/// While it lives, evidence cannot be written, and decisions can.
class Obstacle {
 public:
  explicit Obstacle(const PairScenario& scenario) : folder_(scenario.folder()) {
    for (const char* name : names) {
      std::filesystem::remove(folder_ / name);
      std::filesystem::create_directory(folder_ / name);
    }
  }
  ~Obstacle() {
    for (const char* name : names) std::filesystem::remove(folder_ / name);
  }

 private:
  static constexpr std::array names{"evidence-0", "evidence-1"};
  std::filesystem::path folder_;
};

}  // namespace

TEST_CASE("in an hour without a decision evidence is written once a minute at most, and nothing to the store") {
  PairScenario scenario;
  Writes writes(scenario);
  for (int window = 0; window < 360; ++window) {
    scenario.drive(1);
    writes.look();
  }
  INFO(writes.files << " times, " << writes.bytes << " bytes");
  CHECK(scenario.alerts() == 0);
  CHECK(writes.transactions == 0);
  CHECK(writes.files <= 60);
  CHECK(writes.files >= 50);
  CHECK(writes.bytes + std::uint64_t{4096} * 60 < 1'000'000);  // in blocks of 4 KiB, of which the last is not full
}

TEST_CASE("sensors that are silent for an hour cost no more writes than a drive") {
  PairScenario scenario;
  scenario.drive(2, {.lidar = false});  // not evaluated: a decision
  Writes writes(scenario);
  for (int window = 0; window < 360; ++window) {
    scenario.drive(1, {.lidar = false});
    writes.look();
  }
  CHECK(writes.transactions == 0);
  CHECK(writes.files <= 60);
  CHECK(writes.files >= 50);
}

TEST_CASE("a crash costs a minute of evidence at most, and calibd goes on from what was written last") {
  PairScenario scenario({.learned = false});
  std::map<std::uint64_t, std::string> was;
  for (int crash = 1; crash <= 12; ++crash) {
    for (int window = 0; window < crash; ++window) {
      scenario.drive(1);
      was[scenario.state().evaluated] = evidence(scenario);
    }
    const std::uint64_t before = scenario.state().evaluated;
    scenario.crash();
    const std::uint64_t after = scenario.state().evaluated;
    INFO(crash << " windows: " << before << " pairs before the crash, " << after << " after it");
    REQUIRE(after + minute_of_windows >= before);
    REQUIRE((after == 0 || evidence(scenario) == was.at(after)));
    REQUIRE(scenario.status().verdict == Verdict::not_evaluated);
  }
  scenario.drive(20);
  CHECK(scenario.records(Decision::baseline) == 1);
}

TEST_CASE("an orderly end costs nothing, whenever it comes") {
  PairScenario scenario;
  for (int windows = 1; windows <= 8; ++windows) {
    scenario.drive(windows);
    const std::string before = evidence(scenario);
    const std::uint64_t evaluated = scenario.state().evaluated;
    scenario.restart();
    REQUIRE(scenario.state().evaluated == evaluated);
    REQUIRE(evidence(scenario) == before);
  }
}

TEST_CASE("a crash right after a decision costs nothing of it, nor of the evidence for it") {
  PairScenario scenario({.mode = RecalibrationMode::propose});
  const World knocked{.motion = moved(0, 0, 1)};
  for (const Verdict verdict : {Verdict::suspect, Verdict::drifted}) {
    if (verdict == Verdict::suspect)
      while (scenario.alerts() == 0) scenario.drive(1, knocked);
    else
      REQUIRE(scenario.drive_until(verdict, 20, knocked) <= 20);
    const std::string before = evidence(scenario);
    const std::string was = std::string(to_string(scenario.verdict()));
    const int alerts = scenario.alerts();
    scenario.crash();
    CHECK(evidence(scenario) == before);
    CHECK_THAT(scenario.status().reason, EndsWith("; it was " + was + " when last evaluated"));
    CHECK(scenario.alerts() >= alerts);
  }
  while (scenario.records(Decision::proposed) == 0) scenario.drive(1, knocked);
  scenario.crash();
  CHECK(scenario.records(Decision::proposed) == 1);
  REQUIRE(scenario.status().proposed);
  REQUIRE(scenario.accept());
  const std::uint64_t accepted = scenario.last_record().sequence;
  scenario.drive(3, knocked);
  scenario.crash();
  // What was written for the extrinsic before does not count for the one that was accepted.
  CHECK(scenario.last_record().sequence == accepted);
  CHECK(scenario.error_deg(knocked.motion) < 0.3);
  CHECK(scenario.state().probation.has_value());
  CHECK(scenario.state().probation->pairs <= 3);
}

TEST_CASE("evidence whose files cannot be written goes into the store, which is told once") {
  PairScenario scenario;
  scenario.drive(2);
  const std::uint64_t before = scenario.state().evaluated;
  {
    const Obstacle obstacle(scenario);
    scenario.drive(3 * minute_of_windows);
    CHECK(scenario.status().verdict == Verdict::calibrated);
    CHECK(scenario.state().evaluated == before + 3 * minute_of_windows);
    CHECK(std::ranges::count_if(scenario.journal(), [](const std::string& line) {
            return line.find(" cannot be written: ") != std::string::npos;
          }) == 1);
    scenario.crash();  // costs a minute at most here, too
    CHECK(scenario.state().evaluated + minute_of_windows >= before + 3 * minute_of_windows);
  }
  scenario.drive(3);
  const std::string healed = evidence(scenario);
  scenario.restart();
  CHECK(evidence(scenario) == healed);
}

TEST_CASE("while the store cannot be written nothing is added to the evidence that waits") {
  PairScenario scenario;
  scenario.drive(3);
  scenario.lock_store(true);
  scenario.drive(1);
  const std::string waiting = to_text(scenario.state());
  scenario.drive(20);
  CHECK(to_text(scenario.state()) == waiting);
  scenario.lock_store(false);
  scenario.drive(1);
  const std::string healed = evidence(scenario);
  scenario.crash();  // the first window after a failure is written at once
  CHECK(evidence(scenario) == healed);
}

TEST_CASE("evidence in a file that is not calibd's own is told and left, and the last decision's state counts") {
  PairScenario scenario;
  const std::string decided = [&] {
    scenario.drive(1);
    scenario.drive(2, {.lidar = false});
    return evidence(scenario);
  }();
  scenario.drive(1, {.lidar = false});
  scenario.service().save_evidence();
  for (const char* name : {"evidence-0", "evidence-1"}) {
    REQUIRE(std::filesystem::exists(scenario.folder() / name));
    std::filesystem::resize_file(scenario.folder() / name, 200);
  }
  scenario.crash();
  CHECK(evidence(scenario) == decided);
  CHECK(told(scenario) == 1);
}

TEST_CASE("a power cut in the middle of writing evidence costs that write, and not the one before") {
  PairScenario scenario;
  std::map<std::string, std::string> written;
  for (int write = 0; write < 3; ++write) {
    scenario.drive(1);
    scenario.service().save_evidence();
    written[write % 2 == 0 ? "last" : "before"] = evidence(scenario);
  }
  const auto newest = std::filesystem::last_write_time(scenario.folder() / "evidence-0") >
                              std::filesystem::last_write_time(scenario.folder() / "evidence-1")
                          ? "evidence-0"
                          : "evidence-1";
  std::filesystem::resize_file(scenario.folder() / newest, 4096);
  scenario.crash();
  CHECK(evidence(scenario) == written["before"]);
  CHECK(told(scenario) == 0);
  scenario.drive(2);
  scenario.service().save_evidence();
  const std::string later = evidence(scenario);
  scenario.crash();
  CHECK(evidence(scenario) == later);
}
