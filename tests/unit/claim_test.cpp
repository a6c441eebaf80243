#include "calib/claim.hpp"

#include "support/catch.hpp"

using namespace calib;
using namespace std::chrono_literals;
using Catch::Matchers::EndsWith;
using Catch::Matchers::StartsWith;

namespace {

const Claim calibrated{Verdict::calibrated, std::nullopt, "the extrinsic is where it was"};
const BootTime now{"boot", 100s};

Grounds sound() {
  return {.pairs = 3, .taken = {"boot", 90s}, .lifetime = 22s, .evidence_sha256 = "e", .not_written = std::nullopt};
}

/// What becomes of a verdict on sound grounds of which one thing is changed.
template <typename Change>
Claim changed(Verdict verdict, Change change) {
  Grounds grounds = sound();
  change(grounds);
  return claim({verdict, std::nullopt, "a reason"}, grounds, now);
}

}  // namespace

TEST_CASE("a verdict on sound grounds is shown as it is, with its reason") {
  for (const Verdict verdict : {Verdict::not_evaluated, Verdict::calibrated, Verdict::suspect, Verdict::drifted}) {
    const Claim said = changed(verdict, [](Grounds&) {});
    CHECK(said.verdict == verdict);
    CHECK(said.reason == "a reason");
    CHECK_FALSE(said.cause);
  }
}

TEST_CASE("each thing that grounds lack takes every verdict away, and says which and what was said before") {
  const auto check = [](auto change, const char* code) {
    for (const Verdict verdict : {Verdict::calibrated, Verdict::suspect, Verdict::drifted}) {
      const Claim said = changed(verdict, change);
      CHECK(said.verdict == Verdict::not_evaluated);
      REQUIRE(said.cause);
      CHECK_THAT(said.reason, StartsWith(std::string(to_string(*said.cause)) + ": "));
      CHECK_THAT(said.reason, StartsWith(code));
      CHECK_THAT(said.reason, EndsWith("; it was " + std::string(to_string(verdict)) + " when last evaluated"));
    }
  };
  check([](Grounds& g) { g.pairs = 0; }, "starting: 0 of ");
  check([](Grounds& g) { g.not_written = "disk full"; }, "store_failed: disk full; ");
  check([](Grounds& g) { g.taken.boot_id = "another"; }, "stale: ");
  check([](Grounds& g) { g.taken.since_boot = 77s; },
        "stale: the last evidence is older than the 22 s that it counts for");
  check([](Grounds& g) { g.taken.since_boot = 101s; }, "stale: ");
  const Claim none = claim(calibrated, std::nullopt, now);
  CHECK(none.verdict == Verdict::not_evaluated);
  CHECK_THAT(none.reason, StartsWith("starting: no pair was evaluated since calibd started; it was calibrated"));
}

TEST_CASE("that all is well takes as many pairs as make a median; that something is wrong takes one") {
  for (std::uint64_t pairs = 1; pairs < 5; ++pairs) {
    const auto with = [pairs](Grounds& g) { g.pairs = pairs; };
    CHECK((changed(Verdict::calibrated, with).verdict == Verdict::calibrated) == (pairs >= least_pairs_to_confirm));
    CHECK(changed(Verdict::drifted, with).verdict == Verdict::drifted);
  }
}

TEST_CASE("evidence counts to the last nanosecond of its lifetime, and not after") {
  const auto at = [](std::chrono::nanoseconds time) { return claim(calibrated, sound(), {"boot", time}).verdict; };
  CHECK(at(112s) == Verdict::calibrated);
  CHECK(at(112s + 1ns) == Verdict::not_evaluated);
}

TEST_CASE("what was made of a verdict stays so, whoever applies it again") {
  Grounds grounds = sound();
  const Claim stale = claim(calibrated, grounds, {"boot", 1000s});
  const Claim again = claim(stale, grounds, now);
  CHECK(again.verdict == Verdict::not_evaluated);
  CHECK(again.reason == stale.reason);
  grounds.not_written = "disk full";
  const Claim unwritten = claim(calibrated, grounds, now);
  CHECK(claim(unwritten, grounds, now).reason == unwritten.reason);
  // Also of what was not evaluated it is said that nothing can be written.
  CHECK(claim({Verdict::not_evaluated, ErrorCode::dark, "dark"}, grounds, now).reason == "store_failed: disk full");
}
