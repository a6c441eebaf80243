#include <algorithm>
#include <atomic>
#include <cmath>
#include <set>

#include "calib_eval/commands.hpp"
#include "calib_eval/drift_report.hpp"
#include "support/catch.hpp"
#include "support/support.hpp"
#include "vehicle/random.hpp"

using namespace calib;
using namespace calib::eval;

namespace {

constexpr double hill = 100;  // response of every axis, 1 / rad^2 and 1 / m^2
constexpr double sigma_rad = 0.05 * radians_per_degree;

/// Evidence of frames whose optimum lies where the LiDAR is, give or take `sigma_rad`, along all axes.
std::vector<AxisEvidence> evidence_at(const Vector6& moved, std::size_t frames) {
  std::vector<AxisEvidence> evidence(frames);
  for (std::size_t i = 0; i < frames; ++i) {
    vehicle::Random random(i);
    for (int axis = 0; axis < 6; ++axis) evidence[i].slope[axis] = hill * (moved[axis] + sigma_rad * random.gaussian());
    evidence[i].score = 1.1 + 0.01 * random.gaussian();
    evidence[i].prominence = 0.02 + 0.001 * random.gaussian();
    evidence[i].sensitivity = hill * Matrix6::Identity();
    for (int axis = 0; axis < 6; ++axis) (*evidence[i].sensitivity)(axis, axis) *= 1 + 0.1 * random.gaussian();
  }
  return evidence;
}

Ladder ladder_of(int axis, double step, std::size_t rungs, std::size_t frames) {
  Ladder ladder{axis, step, {}};
  for (std::size_t rung = 0; rung <= rungs; ++rung)
    ladder.rungs.push_back(evidence_at(Vector6::Unit(axis) * step * static_cast<double>(rung), frames));
  return ladder;
}

SequenceSettings settings_with(int threads = 1, std::size_t block = 3) {
  SequenceSettings settings;
  settings.block = block;
  settings.threads = threads;
  return settings;
}

void nothing() {}

}  // namespace

TEST_CASE("frames are drawn in blocks of neighbours, the first after the last, all equally often") {
  constexpr std::size_t frames = 10, block = 4;
  FrameDraw draw(frames, block, 7);
  std::vector<int> times(frames);
  std::set<std::size_t> begins;
  for (int i = 0; i < 10000; ++i) {
    std::size_t frame = draw.next();
    begins.insert(frame);
    for (std::size_t next = 0; next < block; ++next) {
      REQUIRE(frame < frames);
      ++times[frame];
      if (next + 1 < block) REQUIRE(draw.next() == (frame + 1) % frames);
      frame = (frame + 1) % frames;
    }
  }
  CHECK(begins.size() == frames);
  for (const int count : times) CHECK(count == Approx(4000).margin(400));
}

TEST_CASE("a draw depends on its key alone") {
  FrameDraw draw(100, 5, 1), same(100, 5, 1), other(100, 5, 2);
  int different = 0;
  for (int i = 0; i < 100; ++i) {
    const std::size_t frame = draw.next();
    CHECK(frame == same.next());
    different += frame != other.next();
  }
  CHECK(different > 50);
}

TEST_CASE("the usual block is the cube root of the number of frames") {
  CHECK(usual_block(1) == 1);
  CHECK(usual_block(16) == 3);
  CHECK(usual_block(1000) == 10);
}

TEST_CASE("the bound on a rate is Garwood's") {
  // Half the 95 % quantile of chi squared with 2 (count + 1) degrees of freedom.
  CHECK(poisson_upper95(0) == Approx(2.99573).epsilon(1e-5));
  CHECK(poisson_upper95(1) == Approx(4.74386).epsilon(1e-5));
  CHECK(poisson_upper95(5) == Approx(10.51303).epsilon(1e-5));
  CHECK(poisson_upper95(100) == Approx(118.07949).epsilon(1e-5));
  CHECK(poisson_upper95(100000) == Approx(100521.71).epsilon(1e-5));
}

TEST_CASE("evidence between two rungs is interpolated, and none is beyond the last") {
  const Ladder ladder = ladder_of(2, -0.002, 3, 1);
  const auto yaw_at = [&](double offset) { return ladder.at(offset, 0).slope[2] - ladder.rungs[0][0].slope[2]; };
  CHECK(yaw_at(0) == 0);
  CHECK(yaw_at(-0.002) == Approx(-0.2));
  CHECK(yaw_at(-0.003) == Approx(-0.3));
  CHECK(yaw_at(-0.006) == Approx(-0.6));
  CHECK(yaw_at(-1) == Approx(-0.6));
  Ladder flatter = ladder;
  flatter.rungs[1][0].prominence = 0;
  CHECK(flatter.at(-0.001, 0).prominence == Approx(ladder.rungs[0][0].prominence / 2));
  CHECK(ladder.at(-0.003, 0).sensitivity);
}

TEST_CASE("vehicles whose LiDAR stays raise no alarm, and every pair of theirs is accounted for") {
  const auto still = evidence_at(Vector6::Zero(), 60);
  std::atomic<int> done = 0;
  const NullRun run = drive_without_drift(still, settings_with(), 25, [&] { ++done; });
  CHECK(run.sequences == 3);
  CHECK(done == 3);
  CHECK(run.false_alarms == 0);
  CHECK(run.decisions + run.learning + run.insufficient_power == 25 * 56 * 360);
  CHECK(run.learning == 3 * 19);
  CHECK(run.weeks == Approx(25).epsilon(1e-3));
  CHECK(*run.per_1000_weeks() == 0);
  CHECK(*run.upper95_per_1000_weeks() == Approx(2995.73 / run.weeks));
}

TEST_CASE("what is drawn and found does not depend on the number of threads") {
  const auto still = evidence_at(Vector6::Zero(), 20);
  auto settings = settings_with();
  settings.drift.false_alarms_per_pair = 0.01;  // so that there is something to count
  const NullRun one = drive_without_drift(still, settings, 30, nothing);
  settings.threads = 3;
  const NullRun three = drive_without_drift(still, settings, 30, nothing);
  CHECK(one.false_suspects > 0);
  CHECK(one.false_alarms == three.false_alarms);
  CHECK(one.false_suspects == three.false_suspects);
  CHECK(one.decisions == three.decisions);
  settings.seed = 2;
  CHECK(drive_without_drift(still, settings, 30, nothing).false_suspects != one.false_suspects);
}

TEST_CASE("a vehicle whose scenes change for long gets false alarms, and begins anew after each") {
  // Half of the frames see the LiDAR a degree off: as long as they come mixed, that is spread; in a row it is drift.
  auto still = evidence_at(Vector6::Zero(), 1000);
  for (std::size_t i = 500; i < still.size(); ++i) still[i].slope[1] += hill * radians_per_degree;
  const NullRun run = drive_without_drift(still, settings_with(1, 200), 1, nothing);
  CHECK(run.false_alarms > 10);
  CHECK(run.from_start > 0);
  CHECK(run.from_start < run.false_alarms);
  CHECK(run.learning > 2 * run.false_alarms);
  CHECK(*run.per_1000_weeks() == Approx(1000 * static_cast<double>(run.false_alarms) / run.weeks));
}

TEST_CASE("frames without information give no verdict, and no rate of false alarms") {
  auto still = evidence_at(Vector6::Zero(), 30);
  for (AxisEvidence& evidence : still) {
    evidence.slope.setZero();
    evidence.sensitivity->setZero();
  }
  const NullRun run = drive_without_drift(still, settings_with(), 0.1, nothing);
  CHECK(run.decisions == 0);
  CHECK(run.insufficient_power > 1900);
  CHECK_FALSE(run.per_1000_weeks());
  CHECK_FALSE(run.upper95_per_1000_weeks());
  CHECK(to_json(run)["upper95"].is_null());
  CHECK(to_text(run).find("no verdict at all") != std::string::npos);
}

TEST_CASE("a knock is found") {
  constexpr std::size_t frames = 60;
  const auto still = evidence_at(Vector6::Zero(), frames);
  for (const double knock : {0.5 * radians_per_degree, -0.5 * radians_per_degree}) {
    const Ladder ladder = ladder_of(2, knock, 1, frames);
    for (std::size_t number = 0; number < 20; ++number) {
      const MovedRun run = drive_with({&ladder, knock, 0}, still, settings_with(), 100, number);
      REQUIRE(run.learned);
      CHECK(run.detectable);
      REQUIRE(run.delay);
      CHECK(*run.delay <= 10);
      CHECK(run.pairs_before >= DriftSettings{}.baseline_pairs);
      CHECK(run.pairs_before <= DriftSettings{}.baseline_pairs + most_pairs_before);
    }
  }
}

TEST_CASE("a displacement below the detection limit is not found, and is counted as foretold") {
  constexpr std::size_t frames = 60;
  auto still = evidence_at(Vector6::Zero(), frames);
  for (AxisEvidence& evidence : still) evidence.sensitivity->row(3).setZero();
  const Ladder ladder{3, 0.1, {still, still}};
  int pairs = 0, before = 0;
  const MovedRun run =
      drive_with({&ladder, 0.1, 0}, still, settings_with(), 50, 0, [&](const DriftMonitor&, bool moved) {
        ++pairs;
        before += !moved;
      });
  CHECK_FALSE(run.delay);
  CHECK_FALSE(run.detectable);
  CHECK(before == run.pairs_before);
  CHECK(pairs >= before + 50);
}

TEST_CASE("a LiDAR that creeps is found on its way") {
  constexpr std::size_t frames = 60;
  const auto still = evidence_at(Vector6::Zero(), frames);
  constexpr double rung = 0.1 * radians_per_degree;
  const Ladder ladder = ladder_of(0, rung, 10, frames);
  const MovedRun run = drive_with({&ladder, 0, rung / 20}, still, settings_with(), 200, 0);
  REQUIRE(run.delay);
  CHECK(*run.delay > 10);
  CHECK(*run.delay < 100);
}

TEST_CASE("sequences without a detection are the last of all delays") {
  MovedRuns runs{1, 0.5, "deg", std::vector<MovedRun>(10), {}};
  for (int i = 0; i < 10; ++i) {
    runs.runs[i].learned = true;
    if (i < 9) runs.runs[i].delay = i + 1;
  }
  auto summary = runs.summarise();
  CHECK(summary.sequences == 10);
  CHECK(summary.detected == 9);
  CHECK(summary.foretold == 1);
  CHECK(*summary.median_delay == 5);
  CHECK_FALSE(summary.p95_delay);
  CHECK_FALSE(summary.estimate_error);
  const auto estimate = [](double error_deg) {
    return Estimate{error_deg * radians_per_degree, 0.06 * radians_per_degree};
  };
  runs.estimates = {estimate(0.1), std::nullopt, estimate(-0.1), estimate(0.2)};
  summary = runs.summarise();
  CHECK((summary.estimates == 3 && summary.within_2_sigma == 2));
  CHECK(*summary.estimate_error == Approx(0.1));
  CHECK(*summary.estimate_sigma == Approx(0.06));
  CHECK(to_json(runs, true)["p95_delay_pairs"].is_null());
  CHECK(to_json(runs, true)["delays"].size() == 10);

  runs.runs[9].detectable = true;
  runs.runs[0].learned = false;
  summary = runs.summarise();
  CHECK(summary.sequences == 9);
  CHECK(summary.foretold == 0);
  for (MovedRun& run : runs.runs) run = {};
  CHECK_FALSE(runs.summarise().median_delay);
  CHECK(drift_line(runs).find("no baseline") != std::string::npos);
}

TEST_CASE("a knock has a size and a unit") {
  CHECK(test::require_ok(parse_knock("0.25deg")).size == Approx(0.25 * radians_per_degree));
  CHECK(test::require_ok(parse_knock("0.25deg")).rotation);
  CHECK(test::require_ok(parse_knock("10cm")).size == Approx(0.1));
  CHECK_FALSE(test::require_ok(parse_knock("10cm")).rotation);
  for (const char* wrong : {"", "deg", "0deg", "-1deg", "0.5", "10 m", "6deg", "51cm", "nandeg", "0.5degrees"})
    CHECK(parse_knock(wrong).error().code == "bad_knock");
}
