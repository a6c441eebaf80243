#include "service.hpp"

#include <algorithm>
#include <condition_variable>
#include <thread>

#include "support/catch.hpp"
#include "support/pair_scenario.hpp"

using namespace calib;
using namespace calib::test;
using namespace std::chrono_literals;

namespace {

/// One that waits until somebody opens it, and that tells when it is waited at.
class Gate {
 public:
  void wait() {
    std::unique_lock lock(mutex_);
    reached_ = true;
    changed_.notify_all();
    changed_.wait(lock, [this] { return open_; });
  }
  [[nodiscard]] bool reached() {
    std::unique_lock lock(mutex_);
    return changed_.wait_for(lock, 30s, [this] { return reached_; });
  }
  void open() {
    const std::lock_guard lock(mutex_);
    open_ = true;
    changed_.notify_all();
  }

 private:
  std::mutex mutex_;
  std::condition_variable changed_;
  bool reached_ = false, open_ = false;
};

/// What was replied, from whatever thread.
class Reply {
 public:
  void set(ControlReply reply) {
    const std::lock_guard lock(mutex_);
    reply_ = std::move(reply);
    came_.notify_all();
  }
  std::optional<ControlReply> wait(std::chrono::milliseconds most) {
    std::unique_lock lock(mutex_);
    came_.wait_for(lock, most, [this] { return reply_.has_value(); });
    return reply_;
  }

 private:
  std::mutex mutex_;
  std::condition_variable came_;
  std::optional<ControlReply> reply_;
};

std::string refusal(const std::optional<ControlReply>& reply) {
  const auto* error = reply ? std::get_if<Error>(&*reply) : nullptr;
  return error != nullptr ? word(error->code) : "";
}

}  // namespace

TEST_CASE("a change waits for the end of the pair that is measured, and status and records do not") {
  PairScenario scenario;
  Service& service = scenario.service();
  Gate depth;
  scenario.pass_time({.depth = [&](DepthMap&) { depth.wait(); }});
  const std::uint64_t evaluated = scenario.state().evaluated;
  std::thread worker([&] { REQUIRE(service.run([] {})); });
  REQUIRE(depth.reached());

  Reply rolled_back, status, records;
  const Peer root{.may_change = true};
  service.ask({RollbackRequest{.pair = "front", .to = 1}, root,
               [&](ControlReply reply) { rolled_back.set(std::move(reply)); }});
  service.ask({StatusRequest{}, {}, [&](ControlReply reply) { status.set(std::move(reply)); }});
  service.ask({RecordsRequest{1}, {}, [&](ControlReply reply) { records.set(std::move(reply)); }});
  CHECK_FALSE(rolled_back.wait(300ms));
  REQUIRE(status.wait(0ms));
  CHECK(std::get<Status>(*status.wait(0ms)).pairs.at(0).evaluated == evaluated);
  CHECK(std::get<RecordsPage>(*records.wait(0ms)).records.size() == std::get<RecordsPage>(*records.wait(0ms)).stored);

  depth.open();
  const auto reply = rolled_back.wait(30s);
  service.stop();
  worker.join();
  REQUIRE(reply);
  CHECK(std::get<Answer>(*reply).decision == Decision::rolled_back);
  // The pair counted where it was measured, and not at the extrinsic that came into force after it.
  CHECK(scenario.state().evaluated == evaluated + 1);
  CHECK(scenario.state().run.pairs == 0);
  CHECK(scenario.last_record().decision == Decision::rolled_back);
}

TEST_CASE("who may not change anything is refused, and so is one request too many") {
  PairScenario scenario;
  Service& service = scenario.service();
  Gate depth;
  scenario.pass_time({.depth = [&](DepthMap&) { depth.wait(); }});
  std::thread worker([&] { REQUIRE(service.run([] {})); });
  REQUIRE(depth.reached());
  Reply stranger, unknown, last;
  service.ask({AcceptRequest{"front"}, {}, [&](ControlReply reply) { stranger.set(std::move(reply)); }});
  service.ask(
      {AcceptRequest{"rear"}, {.may_change = true}, [&](ControlReply reply) { unknown.set(std::move(reply)); }});
  for (std::size_t i = 2; i < Service::most_requests; ++i)
    service.ask({AcceptRequest{"front"}, {}, [](const ControlReply&) {}});
  service.ask({AcceptRequest{"front"}, {}, [&](ControlReply reply) { last.set(std::move(reply)); }});
  CHECK(refusal(last.wait(0ms)) == "failed");
  depth.open();
  CHECK(refusal(stranger.wait(30s)) == "denied");
  CHECK(refusal(unknown.wait(30s)) == "not_found");
  service.stop();
  worker.join();
}

TEST_CASE("a reload keeps evidence and verdict, and what it takes over is in force; a wrong file changes nothing") {
  PairScenario scenario;
  REQUIRE(scenario.verdict() == Verdict::calibrated);
  const std::string before = to_text(scenario.state());
  const auto frames = scenario.state().run.frames.size();

  CHECK(scenario.reload(fail(ErrorCode::bad_config, "c.yaml:3: wrong")).error().context ==
        "c.yaml:3: wrong; the configuration that calibd runs with stays in force");
  CHECK(to_text(scenario.state()) == before);
  CHECK(scenario.journal().back().starts_with("c.yaml:3: wrong"));
  CHECK(scenario.service().show().value().starts_with("the configuration was not reloaded: c.yaml:3: wrong; front: "));

  Config file = scenario.config();
  file.sha256 = std::string(64, 'f');
  file.sampling.period *= 2;
  file.pairs[0].recalibration.mode = RecalibrationMode::propose;
  file.values = {{"sampling.period", "2"}, {"pairs[0].recalibration.mode", "propose"}};
  const auto changes = scenario.reload(file);
  REQUIRE(changes);
  CHECK(changes->taken_over == std::vector<std::string>{"pairs[0].recalibration.mode", "sampling.period"});
  CHECK(changes->need_restart.empty());
  CHECK(to_text(scenario.state()) == before);
  CHECK(scenario.state().run.frames.size() == frames);
  CHECK(scenario.service().show().value().starts_with("front: calibrated"));
  CHECK(scenario.service().pipeline(0).settings().mode == RecalibrationMode::propose);
  CHECK(scenario.service().pipeline(0).settings().sampling.period == file.sampling.period);
  scenario.drive(3);
  CHECK(scenario.verdict() == Verdict::calibrated);
  CHECK(scenario.alerts() == 0);
  // Later records name the file that was read.
  REQUIRE(scenario.roll_back(1));
  CHECK(scenario.last_record().configuration_sha256 == file.sha256);
}

TEST_CASE("sensors that never send are told of once, after a minute; a night is not") {
  PairScenario scenario({.learned = false});
  scenario.drive(5, {.camera = false});
  CHECK(scenario.alerts() == 0);
  scenario.drive(20, {.camera = false});
  CHECK(scenario.alerts(Verdict::not_evaluated) == 1);
  CHECK(std::ranges::count_if(scenario.journal(), [](const std::string& line) {
          return line.starts_with("front: no evidence for 60 s: sensor_silent: ");
        }) == 1);

  PairScenario by_night({.learned = false});
  by_night.drive(20, {.samples = [](FramePair& pair) { std::ranges::fill(pair.image.pixels, std::uint8_t{0}); }});
  CHECK(by_night.alerts() == 0);
}

TEST_CASE("what cannot be written has not happened: the state is that of before, and healed the pair goes on") {
  PairScenario scenario;
  const std::string before = to_text(scenario.state());
  scenario.lock_store(true);
  scenario.drive(3);
  CHECK(to_text(scenario.state()) == before);
  CHECK(scenario.status().verdict == Verdict::not_evaluated);
  CHECK(scenario.status().reason.starts_with("store_failed: "));
  CHECK(scenario.alerts() == 0);
  CHECK(scenario.service().roll_back(0, 1, "uid:7").error().code == "failed");
  scenario.lock_store(false);
  scenario.drive(2);  // what was measured meanwhile is lost, so the verdict is confirmed anew
  CHECK(scenario.status().verdict == Verdict::not_evaluated);
  scenario.drive(1);
  CHECK(scenario.verdict() == Verdict::calibrated);
}
