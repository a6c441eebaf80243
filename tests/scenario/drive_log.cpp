// Prints all that calibd decides on a drive: verdicts, scores to the last bit, records, alerts and journal. Two builds
// that print the same decide the same:
//   drive_log >A; drive_log DATE/DRIVE >B    the simulated block, or a recorded drive (KITTI raw)
#include <cinttypes>
#include <cstdio>

#include "calib/store.hpp"
#include "support/pair_scenario.hpp"

using namespace calib;
using namespace calib::test;

namespace {

class Log {
 public:
  explicit Log(const char* title, const PairScenario::Settings& settings) : scenario_(settings) {
    std::printf("== %s\n", title);
  }
  ~Log() {
    const TemporaryFolder folder;
    scenario_.save(folder.path());
    const Store store = require_ok(Store::open(folder.path() / "calibd.db", Store::Mode::read_only));
    for (std::uint64_t i = 1; i <= require_ok(store.record_count()); ++i)
      std::printf("record %s\n", require_ok(store.record(i)).canonical.c_str());
    for (const Store::Alert& alert : require_ok(store.latest_alerts(1000)))
      std::printf("alert %s\n", alert.json.c_str());
  }

  void drive(int windows, const World& world = {}) {
    for (int i = 0; i < windows; ++i) {
      scenario_.drive(1, world);
      print();
    }
  }
  PairScenario& scenario() { return scenario_; }
  void print() {
    const PairStatus status = scenario_.status();
    std::printf("%" PRIu64 " %s %s\n", status.evaluated, to_string(status.verdict).data(), status.reason.c_str());
    if (status.score)
      std::printf("  score %a %a %a\n", status.score->current, status.score->best_neighbour,
                  status.score->baseline.value_or(-1));
    if (status.misalignment)
      for (int i = 0; i < 6; ++i)
        std::printf("  %a +- %a\n", status.misalignment->delta[i], status.misalignment->sigma[i]);
    for (const auto& [code, count] : status.skipped) std::printf("  %s %" PRIu64 "\n", code.c_str(), count);
    for (; told_ < scenario_.journal().size(); ++told_)
      std::printf("  journal %s\n", scenario_.journal()[told_].c_str());
  }

 private:
  PairScenario scenario_;
  std::size_t told_ = 0;
};

void tell(const Result<Answer>& answer) {
  std::printf("%s\n", answer ? to_string(answer->decision).data() : answer.error().context.c_str());
}

}  // namespace

int main(int argc, char** argv) {
  if (argc > 1) Block::recording = argv[1];
  const World knocked{.motion = moved(0, 0.4, 1)};
  {
    Log log("a knock, a new extrinsic, its probation", {.learned = false});
    log.drive(40);
    log.drive(100, knocked);
    log.scenario().restart();
    log.drive(10, knocked);
  }
  {
    Log log("a proposal that is accepted, and does worse", {.mode = RecalibrationMode::propose, .learned = false});
    log.drive(40);
    log.drive(40, knocked);
    log.drive(30);
    tell(log.scenario().accept());
    log.drive(30);
    tell(log.scenario().roll_back());
    log.drive(6);
  }
  {
    Log log("faults", {.learned = false});
    log.drive(30);
    log.drive(3, {.camera = false});
    log.drive(3, {.lidar = false});
    log.drive(3, {.frozen = true});
    log.drive(3, {.lidar_clock = std::chrono::milliseconds(80)});
    log.scenario().restart("UPDATE state SET json = replace(json, '1', '2')");
    log.drive(10);
    log.scenario().restart("", std::string(64, 'f'));
    log.drive(30);
  }
  {
    Log log("wrong from the start", {.wrong_from_start = moved(0, 2, 0), .learned = false});
    log.drive(60);
  }
}
