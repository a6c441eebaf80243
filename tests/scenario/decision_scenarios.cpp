// What is signed, what is refused, what is taken back, and what survives a restart.
#include <algorithm>

#include "support/catch.hpp"
#include "support/pair_scenario.hpp"

using namespace calib;
using namespace calib::test;
using namespace std::chrono_literals;
using Catch::Matchers::ContainsSubstring;
using Catch::Matchers::EndsWith;
using Catch::Matchers::StartsWith;

namespace {

/// Depth that is suddenly beside the image by so many pixels: as if somebody had changed the depth source's
/// calibration.
World shifted_depth(int pixels) {
  return {.depth = [pixels](DepthMap& depth) {
    for (int row = 0; row < depth.height; ++row) {
      const auto begin = depth.inverse_depth.begin() + row * depth.width;
      std::shift_left(begin, begin + depth.width, pixels);
      std::fill(begin + depth.width - pixels, begin + depth.width, DepthMap::no_depth);
    }
  }};
}

}  // namespace

TEST_CASE("depth that is suddenly wrong looks like a LiDAR that has moved, and is not signed as a new extrinsic") {
  PairScenario scenario;
  const World biased = shifted_depth(6);
  CHECK(scenario.drive_until(Verdict::drifted, 20, biased) <= 20);
  scenario.drive(40, biased);
  INFO(scenario.reason());
  CHECK(scenario.records(Decision::accepted) == 0);
  CHECK(scenario.records(Decision::rejected) == 1);
  INFO(scenario.reason(Decision::rejected));
  CHECK(scenario.error_deg(Vector6::Zero()) < 1e-6);
  // When depth is well again all is well, without anybody's doing.
  CHECK(scenario.drive_until(Verdict::calibrated, 60) <= 60);
  CHECK(scenario.alerts(Verdict::drifted) == 1);
}

TEST_CASE("refused recalibrations come ever more rarely, in pairs and in time, also over a restart", "[release-only]") {
  PairScenario scenario;
  const World biased = shifted_depth(6);
  scenario.drive(60, biased);
  CHECK(scenario.records(Decision::rejected) == 1);
  CHECK_THAT(scenario.reason(), ContainsSubstring("; the next is tried "));
  scenario.restart();
  // The interval of ten minutes, doubled: 120 pairs.
  scenario.drive(60, biased);
  CHECK(scenario.records(Decision::rejected) == 1);
  scenario.drive(60, biased);
  CHECK(scenario.records(Decision::rejected) == 2);
  scenario.restart();
  // Doubled again: 240.
  scenario.drive(180, biased);
  CHECK(scenario.records(Decision::rejected) == 2);
  scenario.drive(40, biased);
  CHECK(scenario.records(Decision::rejected) == 3);
  CHECK(scenario.records(Decision::accepted) == 0);
}

TEST_CASE(
    "an extrinsic that was accepted and does worse is taken back by itself, and the earlier baseline holds again") {
  PairScenario scenario({.mode = RecalibrationMode::propose});
  const World knocked{.motion = moved(0, 0, 1)};
  scenario.drive(40, knocked);
  REQUIRE(scenario.records(Decision::proposed) == 1);
  // Somebody has put the LiDAR back, and somebody else accepts what was proposed before.
  scenario.drive_until(Verdict::calibrated, 60);
  REQUIRE(scenario.accept());
  CHECK(scenario.error_deg(Vector6::Zero()) > 0.7);
  scenario.drive(4);
  CHECK_THAT(scenario.reason(), ContainsSubstring("learning the baseline: 4 of 20 scenes; the extrinsic of record "));
  CHECK_THAT(scenario.reason(), ContainsSubstring(" is on probation"));
  scenario.restart();
  CHECK(scenario.state().probation->pairs == 4);
  scenario.drive(4);
  CHECK(scenario.records(Decision::rolled_back) == 1);
  CHECK_THAT(scenario.reason(Decision::rolled_back),
             ContainsSubstring("has not passed its probation: surely worse: over"));
  CHECK(scenario.error_deg(Vector6::Zero()) < 1e-6);
  CHECK(scenario.state().refusals == 1);
  scenario.drive(least_pairs_to_confirm);
  CHECK(scenario.verdict() == Verdict::calibrated);
  CHECK(scenario.records(Decision::baseline) == 0);  // that of before is good enough
}

TEST_CASE("where the objective has a false hill far away, nothing is signed that is worse than before",
          "[release-only]") {
  const Vector6 far = moved(3, -4, 4.5);
  PairScenario scenario;
  CHECK(scenario.drive_until(Verdict::drifted, 20, {.motion = far}) <= 20);
  const double before_deg = scenario.error_deg(far);
  scenario.drive(60, {.motion = far});
  INFO(scenario.reason() << "; " << scenario.error_deg(far) << " degrees off, " << before_deg << " before");
  CHECK(scenario.records(Decision::accepted) + scenario.records(Decision::rejected) == 1);
  if (scenario.records(Decision::accepted) == 1)
    CHECK(scenario.error_deg(far) < 0.3);
  else
    CHECK(scenario.verdict() == Verdict::drifted);
}

TEST_CASE("a restart in the middle of a drift forgets no evidence, and claims nothing before it has evidence again") {
  PairScenario straight({.mode = RecalibrationMode::propose}), restarted({.mode = RecalibrationMode::propose});
  const World knocked{.motion = moved(0, 0.3, 0)};
  const auto evidence = [](PairScenario& scenario) {
    PairState only;
    only.drift = scenario.state().drift;
    return to_text(only);
  };
  for (int window = 0; window < 40; ++window) {
    straight.drive(1, knocked);
    restarted.drive(1, knocked);
    REQUIRE(evidence(restarted) == evidence(straight));
    // The first two pairs of a run confirm no verdict that all is well.
    if (window % 4 >= 2 || straight.verdict() != Verdict::calibrated)
      REQUIRE(restarted.verdict() == straight.verdict());
    if (window >= 4 && window % 4 < 2) REQUIRE(restarted.status().verdict != Verdict::calibrated);
    if (window % 4 == 3) {
      restarted.restart();
      REQUIRE(restarted.status().verdict == Verdict::not_evaluated);
      REQUIRE_THAT(restarted.status().reason, StartsWith("starting: no pair was evaluated since calibd started"));
      REQUIRE_THAT(restarted.status().reason, EndsWith("when last evaluated"));
    }
  }
  CHECK(straight.alerts(Verdict::drifted) == 1);
  CHECK(restarted.alerts(Verdict::drifted) >= 1);
  CHECK(restarted.records(Decision::baseline) == 0);
}

TEST_CASE("when the saved state cannot be trusted the signed baseline is gone on from") {
  PairScenario scenario;
  scenario.restart(
      GENERATE(as<std::string>(), "UPDATE state SET json = 'spoilt'",
               // A baseline that calls a LiDAR that is half a degree off normal.
               "UPDATE state SET json = replace(json, '\"slope\":[', '\"slope\":[1')",
               "UPDATE state SET json = replace(json, '\"verdict\":\"calibrated\"', '\"verdict\":\"drifted\"')"));
  REQUIRE(scenario.journal().size() == 1);
  CHECK_THAT(scenario.journal()[0], ContainsSubstring("was not written by calibd with this signing key"));
  CHECK_THAT(scenario.journal()[0], ContainsSubstring("the baseline is that of the records"));
  CHECK(scenario.verdict() == Verdict::not_evaluated);
  scenario.drive(least_pairs_to_confirm);
  CHECK(scenario.verdict() == Verdict::calibrated);
  CHECK(scenario.drive_until(Verdict::drifted, 20, {.motion = moved(0, 0, 0.5)}) <= 8);
  CHECK(scenario.records(Decision::baseline) == 0);
}

TEST_CASE("evidence that was measured with something else is set aside, and never signed as a baseline") {
  PairScenario scenario({.learned = false});
  scenario.drive(19);
  const std::string before = scenario.state().evidence_sha256;
  scenario.restart("", "another camera");
  REQUIRE(scenario.journal().size() == 1);
  CHECK_THAT(scenario.journal()[0], ContainsSubstring("another configuration, depth model or calibd; the baseline is "
                                                      "learned anew"));
  scenario.drive(19);
  CHECK(scenario.records(Decision::baseline) == 0);
  scenario.drive(1);
  CHECK(scenario.records(Decision::baseline) == 1);
  CHECK(scenario.verdict() == Verdict::calibrated);
  CHECK(scenario.last_record().evidence_sha256 == scenario.state().evidence_sha256);
  CHECK(scenario.last_record().evidence_sha256 != before);
  // Back again: the baseline of the other one does not count either.
  scenario.restart("", std::string(64, 'e'));
  scenario.drive(10);
  CHECK(scenario.status().verdict == Verdict::not_evaluated);
}

TEST_CASE("a drift is not forgotten with its evidence, until an extrinsic is put in force") {
  PairScenario scenario({.mode = RecalibrationMode::propose});
  const World knocked{.motion = moved(0, 0.2, 0)};
  REQUIRE(scenario.drive_until(Verdict::drifted, 60, knocked) <= 60);
  scenario.restart("", std::string(64, 'f'));
  CHECK_THAT(scenario.reason(), EndsWith("; it was drifted when last evaluated"));
  // At 0.2 degrees off, what is learned anew looks normal.
  for (int window = 0; window < 60; ++window) {
    scenario.drive(1, knocked);
    REQUIRE(scenario.status().verdict != Verdict::calibrated);
  }
  CHECK_THAT(scenario.reason(), StartsWith("unresolved: it was drifted before its evidence was set aside"));
  scenario.restart();
  scenario.drive(10, knocked);
  REQUIRE(scenario.status().verdict != Verdict::calibrated);
  // Somebody has looked, and confirms what is in force.
  REQUIRE(scenario.roll_back(1));
  CHECK(scenario.drive_until(Verdict::calibrated, 60, knocked) <= 60);
}

TEST_CASE("an extrinsic that has stood its probation is not put on probation again by a change of configuration") {
  PairScenario scenario;
  const World knocked{.motion = moved(0, 0, 1)};
  scenario.drive(80, knocked);
  REQUIRE(scenario.records(Decision::accepted) == 1);
  REQUIRE_FALSE(scenario.state().probation);
  scenario.restart(GENERATE("", "UPDATE state SET json = 'spoilt'"), std::string(64, 'f'));
  CHECK_FALSE(scenario.state().probation);
  scenario.drive(40, knocked);
  CHECK(scenario.records(Decision::rolled_back) == 0);
  CHECK(scenario.verdict() == Verdict::calibrated);
}

TEST_CASE("a record that was cut off is noticed, and evidence of later than the records is set aside") {
  PairScenario scenario;
  scenario.restart("DELETE FROM record WHERE sequence = (SELECT max(sequence) FROM record)");
  REQUIRE(scenario.status().verdict == Verdict::not_evaluated);
  CHECK_THAT(scenario.journal().at(0), ContainsSubstring("records 3 to 3, which calibd had written, are missing"));
  CHECK_THAT(scenario.journal().at(1), ContainsSubstring("is of another time than the records"));
  CHECK(scenario.drive_until(Verdict::calibrated, 5) <= 5);
  scenario.drive(280);
  CHECK_THAT(scenario.last_record().reason, ContainsSubstring(", which calibd had written, are missing"));
}

TEST_CASE("what was in force can be again, and nothing else") {
  PairScenario scenario;
  CHECK(scenario.roll_back().error().code == "not_found");
  CHECK(scenario.roll_back(2).error().code == "bad_request");  // a baseline
  CHECK(scenario.roll_back(99).error().code == "not_found");
  CHECK(scenario.accept().error().code == "not_found");
  const World knocked{.motion = moved(0, 0, 1)};
  scenario.drive(80, knocked);
  REQUIRE(scenario.records(Decision::accepted) == 1);
  CHECK(scenario.verdict() == Verdict::calibrated);
  CHECK(require_ok(scenario.roll_back()).decision == Decision::rolled_back);
  CHECK(scenario.verdict() == Verdict::not_evaluated);
  CHECK_FALSE(scenario.state().probation);
  // Against the baseline of then the knock shows at once.
  CHECK(scenario.drive_until(Verdict::drifted, 20, knocked) <= 8);
}
