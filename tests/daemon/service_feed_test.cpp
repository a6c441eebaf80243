// What the service tells the fleet, and who takes it.
#include <algorithm>
#include <future>
#include <nlohmann/json.hpp>
#include <thread>

#include "service.hpp"
#include "support/catch.hpp"
#include "support/pair_scenario.hpp"

using namespace calib;
using namespace calib::test;
using namespace std::chrono_literals;

namespace {

/// What is replied to a request, from whatever thread.
class Question {
 public:
  Question(Service& service, ControlRequest request, const Peer& peer = {}) {
    const auto promise = std::make_shared<std::promise<ControlReply>>();
    reply_ = promise->get_future().share();
    service.ask({std::move(request), peer, [promise](ControlReply made) { promise->set_value(std::move(made)); }});
  }
  [[nodiscard]] bool is_answered() const { return reply_.wait_for(0s) == std::future_status::ready; }
  template <typename Reply>
  [[nodiscard]] Reply as() const {
    REQUIRE(reply_.wait_for(30s) == std::future_status::ready);
    return std::get<Reply>(reply_.get());
  }

 private:
  std::shared_future<ControlReply> reply_;
};

FeedPage page_of(Service& service) { return Question(service, FeedRequest{}).as<FeedPage>(); }

void show(Service& service) { [[maybe_unused]] const auto verdicts = service.show(); }

std::size_t count(const FeedPage& page, const std::string& type) {
  return static_cast<std::size_t>(std::ranges::count_if(page.events, [&](const Store::Event& event) {
    return nlohmann::json::parse(event.json).at("type") == "calibd." + type + ".v1";
  }));
}

}  // namespace

TEST_CASE("decisions and the daily state are told; each as it is written") {
  PairScenario scenario;
  Service& service = scenario.service();
  const FeedPage before = page_of(service);
  CHECK(before.vehicle == "car");
  CHECK(count(before, "record.initial") == 1);
  CHECK(count(before, "record.baseline") >= 1);
  CHECK(count(before, "feed.state") == 1);
  REQUIRE(scenario.roll_back(1));
  const FeedPage after = page_of(service);
  CHECK(count(after, "drift.rolled_back") == 1);
  CHECK(after.waiting == after.events.size());
  CHECK(service.status().feed_queued == after.waiting);
  scenario.restart();
  CHECK(page_of(scenario.service()).waiting == after.waiting);
}

TEST_CASE("who waits for an event gets it once it is there") {
  PairScenario scenario;
  Service& service = scenario.service();
  const std::uint64_t last = page_of(service).events.back().sequence;
  const Question there(service, FeedRequest{.after = last - 1, .wait = true});
  CHECK(there.as<FeedPage>().events.size() == 1);
  const Question waits(service, FeedRequest{.after = last, .wait = true});
  show(service);
  CHECK_FALSE(waits.is_answered());
  REQUIRE(scenario.roll_back(1));
  show(service);
  REQUIRE(waits.is_answered());
  CHECK(waits.as<FeedPage>().events.at(0).sequence == last + 1);
  std::vector<Question> many;
  for (std::size_t i = 0; i <= Service::most_waiting_for_events; ++i)
    many.emplace_back(service, FeedRequest{.after = last + 1, .wait = true});
  CHECK_FALSE(many.front().is_answered());
  CHECK(many.back().as<FeedPage>().events.empty());
}

TEST_CASE("events are acknowledged by who may, and of this run of calibd") {
  PairScenario scenario;
  Service& service = scenario.service();
  const FeedPage page = page_of(service);
  REQUIRE(page.events.size() >= 3);
  scenario.pass_time();
  std::thread worker([&] { REQUIRE(service.run([] {})); });
  const auto acknowledge = [&](const std::string& run, const Peer& peer) {
    return Question(service, AcknowledgeRequest{page.events[1].sequence, run}, peer);
  };
  const Peer uplink{.may_acknowledge = true};
  const auto stranger = acknowledge(page.run, {}).as<Error>(), late = acknowledge("another run", uplink).as<Error>();
  const std::uint64_t waiting = page_of(service).waiting;
  const auto done = acknowledge(page.run, uplink).as<Acknowledged>();
  // Who may acknowledge may not change anything else.
  const auto denied = Question(service, RollbackRequest{.pair = "front", .to = 1}, uplink).as<Error>();
  service.stop();
  worker.join();
  CHECK(stranger.code == ErrorCode::denied);
  CHECK(late.code == ErrorCode::bad_request);
  CHECK(waiting >= page.waiting);
  CHECK(done.waiting == waiting - 2);
  CHECK(page_of(service).events.front().sequence == page.events[2].sequence);
  CHECK(denied.code == ErrorCode::denied);
}

TEST_CASE("that the store could not be written is told once it can be again") {
  PairScenario scenario;
  scenario.lock_store(true);
  scenario.drive(2);
  scenario.lock_store(false);
  scenario.drive(2);
  const FeedPage page = page_of(scenario.service());
  REQUIRE(count(page, "store.trouble") == 1);
  CHECK(page.events.back().json.find("it can be written again") != std::string::npos);
  scenario.drive(2);
  CHECK(count(page_of(scenario.service()), "store.trouble") == 1);
}

TEST_CASE("a pair that has no verdict for hours is told, and a state once a day") {
  PairScenario scenario;
  scenario.drive(800, {.camera = false});  // more than two hours
  const FeedPage page = page_of(scenario.service());
  CHECK(count(page, "drift.unavailable") == 1);
  CHECK(count(page, "feed.state") == 1);
}
