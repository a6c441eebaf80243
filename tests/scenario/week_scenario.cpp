// A week of driving, 56 hours of it, at accelerated time: pairs that were measured once come again in any order.
#include "support/catch.hpp"
#include "support/pair_scenario.hpp"
#include "vehicle/random.hpp"

using namespace calib;
using namespace calib::test;

TEST_CASE("a week of driving raises no alert, and the knock at its end does") {
  PairScenario scenario({.learned = false});
  std::vector<Measurement> good, knocked;
  for (int frame = 0; frame < Block::frames; ++frame) {
    good.push_back(scenario.measure(frame, {}));
    knocked.push_back(scenario.measure(frame, {.motion = moved(0, 0.5, 0)}));
  }
  vehicle::Random random(7);
  const auto drive = [&](const std::vector<Measurement>& pairs, int windows) {
    // Some frames in turn, as one drives, then from somewhere else.
    for (int i = 0, frame = 0; i < windows; ++i) {
      frame = random.chance(0.2F) ? random.below(Block::frames) : (frame + 1) % Block::frames;
      scenario.observe(pairs[static_cast<std::size_t>(frame)]);
    }
  };
  drive(good, 56 * 360);
  CHECK(scenario.status().evaluated == 20'160);
  CHECK(scenario.verdict() == Verdict::calibrated);
  CHECK((scenario.alerts() == 1 && scenario.alerts(Verdict::calibrated) == 1));
  CHECK(scenario.records(Decision::baseline) == 3);
  CHECK(scenario.records(Decision::accepted) + scenario.records(Decision::rejected) == 0);
  drive(knocked, 8);
  CHECK(scenario.alerts(Verdict::drifted) == 1);
}
