#include "pair_pipeline.hpp"

#include <cmath>
#include <set>

#include "calib/depth_stereo.hpp"
#include "support/catch.hpp"
#include "support/pair_loop.hpp"
#include "support/support.hpp"
#include "vehicle/vehicle.hpp"

using namespace calib;
using namespace std::chrono_literals;

namespace {

/// The simulated vehicle with its stereo camera, and a monitor that learns quickly.
struct Drive {
  explicit Drive(std::uint64_t seed) : vehicle(test::require_ok(vehicle::simulated_vehicle(small(seed)))) {}

  static vehicle::Simulation small(std::uint64_t seed) {
    vehicle::Simulation simulation;
    simulation.seed = seed;
    simulation.width = 480;
    simulation.height = 144;
    simulation.lidar = {.azimuth_step_deg = 0.3, .field_of_view_deg = 110};
    return simulation;
  }

  [[nodiscard]] FramePair pair(int index, const Vector6& knock = Vector6::Zero()) const {
    FramePair pair = test::require_ok(vehicle.frame(index, 4.0 * index, perturbation(knock)));
    pair.image.stamp = pair.right_image->stamp = pair.scan.stamp = 4s * index;
    return pair;
  }
  [[nodiscard]] test::PairLoop loop(RecalibrationMode mode = RecalibrationMode::apply) const {
    PairSettings settings{.vehicle = "car", .pair = "front", .camera = vehicle.camera};
    settings.frames = 8;
    settings.mode = mode;
    settings.drift.baseline_pairs = 10;
    return {settings, vehicle.T_camera_lidar};
  }
  [[nodiscard]] Result<void> evaluate(test::PairLoop& loop, const FramePair& samples) const {
    return loop.evaluate(samples, *depth);
  }

  vehicle::Vehicle vehicle;
  std::unique_ptr<DepthEstimator> depth = test::require_ok(make_stereo_depth(vehicle.camera, vehicle.baseline_m));
};

Vector6 yaw(double degrees) { return Vector6::Unit(2) * degrees * radians_per_degree; }

/// Why there is no result; empty when there is one.
template <typename T>
std::string code(const Result<T>& result) {
  return result ? "" : word(result.error().code);
}

}  // namespace

TEST_CASE("a displacement is found and recalibrated from pairs taken since, and the new extrinsic starts anew") {
  const Drive drive(71);
  test::PairLoop loop = drive.loop();
  CHECK(loop.recalibrate().error().code == "not_ready");
  for (int i = 0; i < 14; ++i) {
    CHECK(loop.can_recalibrate() == (i >= 10));
    auto measurement = test::require_ok(loop.measure(drive.pair(i), *drive.depth));
    CHECK(measurement.stencil.current > 1);
    CHECK(measurement.sensitivity.has_value());
    const Stencil stencil = measurement.stencil;
    const FeatureSet features = measurement.features;
    CHECK(score(features, drive.vehicle.T_camera_lidar).value == stencil.current);
    CHECK(score(features, drive.vehicle.T_camera_lidar * perturbation(yaw(2))).value < stencil.current);
    REQUIRE(loop.decide(std::move(measurement)));
    CHECK(loop.state().score->current == stencil.current);
    CHECK(loop.state().evaluated == static_cast<std::uint64_t>(i + 1));
  }
  REQUIRE(loop.state().verdict == Verdict::calibrated);

  int last = 14;
  for (; last < 50 && !(loop.state().verdict == Verdict::drifted && loop.can_recalibrate()); ++last)
    REQUIRE(drive.evaluate(loop, drive.pair(last, yaw(-1))));
  REQUIRE(loop.state().verdict == Verdict::drifted);
  CHECK(last <= 26);
  const Timestamp onset = *loop.monitor().onset();
  const auto answer = test::require_ok(loop.recalibrate());
  INFO(answer.reason);
  CHECK(answer.decision == Decision::accepted);
  CHECK(answer.result->delta[2] == Approx(-radians_per_degree).margin(0.35 * radians_per_degree));
  const CalibrationRecord& record = *loop.history().in_force();
  CHECK(std::set(record.frame_stamps_ns.begin(), record.frame_stamps_ns.end()).size() == 10);
  CHECK(record.frame_stamps_ns.front() >= onset.count());
  CHECK(Timestamp(record.frame_stamps_ns.front()) >= 4s * 13);  // none, or hardly any, of before the displacement

  CHECK(loop.state().T_camera_lidar.matrix() == answer.result->T_camera_lidar.matrix());
  CHECK(loop.state().verdict == Verdict::not_evaluated);
  CHECK(loop.state().drift.recent.empty());
  CHECK(loop.state().run.frames.empty());
  CHECK(loop.state().probation);
  for (int i = 0; i < 11; ++i) REQUIRE(drive.evaluate(loop, drive.pair(last + i, yaw(-1))));
  CHECK(loop.state().verdict == Verdict::calibrated);
  CHECK_FALSE(loop.state().probation);
}

TEST_CASE("a pair that carries no information is refused by name, and nothing is decided about it") {
  const Drive drive(72);
  test::PairLoop loop = drive.loop();
  const FramePair good = drive.pair(0);
  REQUIRE(drive.evaluate(loop, good));
  const auto refusal = [&](const FramePair& pair) { return code(drive.evaluate(loop, pair)); };
  const auto damaged = [&](auto damage) {
    FramePair pair = drive.pair(1);
    damage(pair);
    return refusal(pair);
  };
  CHECK(refusal(good) == "standing_still");
  CHECK(damaged([](FramePair& pair) { pair.image.pixels.assign(pair.image.pixels.size(), 5); }) == "dark");
  CHECK(damaged([](FramePair& pair) { pair.image.pixels.assign(pair.image.pixels.size(), 255); }) == "saturated");
  CHECK(damaged([](FramePair& pair) { pair.image = {}; }) == "image_size_mismatch");
  CHECK(damaged([](FramePair& pair) { pair.scan.points.clear(); }) == "low_overlap");
  CHECK(damaged([](FramePair& pair) {
          for (LidarPoint& p : pair.scan.points) p.x_m = -std::abs(p.x_m) - 5;
        }) == "low_overlap");
  CHECK(damaged([](FramePair& pair) { pair.right_image.reset(); }) == "depth_failed");
  CHECK(damaged([](FramePair& pair) { pair.right_image->pixels.assign(pair.right_image->pixels.size(), 90); }) ==
        "few_valid_depth");
  CHECK(loop.state().run.frames.size() == 1);
  CHECK(loop.state().drift.recent.size() == 1);
  // A refused pair is no reason to call the next one standing still.
  CHECK(refusal(drive.pair(1)).empty());
}

TEST_CASE("after a rejected recalibration the next one waits for new pairs, and the verdict stays") {
  const Drive drive(73);
  test::PairLoop loop = drive.loop();
  for (int i = 0; i < 12; ++i) REQUIRE(drive.evaluate(loop, drive.pair(i)));
  REQUIRE(loop.can_recalibrate());
  const PairState before = loop.state();
  CHECK(test::require_ok(loop.recalibrate()).decision == Decision::rejected);
  CHECK_FALSE(loop.can_recalibrate());
  CHECK(loop.state().run.frames.empty());
  CHECK(loop.state().verdict == before.verdict);
  CHECK(loop.state().refusals == 1);
  CHECK(to_text(loop.state()).find("\"refusals\":1") != std::string::npos);
}

TEST_CASE("a dry run decides and changes nothing") {
  const Drive drive(74);
  test::PairLoop loop = drive.loop();
  for (int i = 0; i < 12; ++i) REQUIRE(drive.evaluate(loop, drive.pair(i)));
  const std::string before = to_text(loop.state());
  const auto answer = test::require_ok(loop.recalibrate(/*dry_run=*/true));
  CHECK(answer.dry_run);
  CHECK(answer.decision == Decision::rejected);  // without a sign of drift
  CHECK_FALSE(answer.record);
  CHECK(to_text(loop.state()) == before);
  CHECK(loop.state().run.frames.size() == 10);
  CHECK(loop.state().T_camera_lidar.matrix() == drive.vehicle.T_camera_lidar.matrix());
}

TEST_CASE("how far the LiDAR has moved is what a search finds while there is evidence of drift") {
  const Drive drive(77);
  test::PairLoop loop = drive.loop(RecalibrationMode::propose);
  CHECK_FALSE(loop.status().misalignment);
  int next = 0;
  for (; next < 24; ++next) REQUIRE(drive.evaluate(loop, drive.pair(next)));
  CHECK_FALSE(loop.state().run.searched_at);
  for (; next < 50 && !loop.state().run.optimum; ++next) REQUIRE(drive.evaluate(loop, drive.pair(next, yaw(2))));
  REQUIRE(loop.state().verdict == Verdict::drifted);
  REQUIRE(loop.state().run.optimum);
  const auto shown = *loop.status().misalignment;
  CHECK(shown.delta == loop.state().run.optimum->delta);
  CHECK(shown.delta[2] == Approx(2 * radians_per_degree).margin(3 * shown.sigma[2]));
  CHECK(shown.sigma[2] < 0.3 * radians_per_degree);
  CHECK_THAT(loop.state().reason,
             Catch::Matchers::ContainsSubstring("yaw 2.") || Catch::Matchers::ContainsSubstring("yaw 1.9"));

  // It holds for some pairs, and a search that finds nothing within the bounds takes it back.
  const std::uint64_t searched_at = *loop.state().run.searched_at;
  REQUIRE(drive.evaluate(loop, drive.pair(next++, yaw(2))));
  CHECK(loop.state().run.searched_at == searched_at);
  test::PairLoop lost = loop;
  auto measurement = test::require_ok(lost.measure(drive.pair(next, yaw(2)), *drive.depth));
  measurement.optimum = fail(ErrorCode::search_failed, "ends at the limit of yaw");
  REQUIRE(lost.decide(std::move(measurement)));
  CHECK_FALSE(lost.state().run.optimum);
  CHECK(lost.state().run.searched_at == lost.state().evaluated);

  // It ends with the drift.
  for (; next < 90 && loop.state().verdict != Verdict::calibrated; ++next)
    REQUIRE(drive.evaluate(loop, drive.pair(next)));
  REQUIRE(loop.state().verdict == Verdict::calibrated);
  CHECK_FALSE(loop.state().run.optimum);
  CHECK_FALSE(loop.state().run.searched_at);
}

TEST_CASE("windows without a measurement are counted by reason; the second in turn takes the verdict away") {
  const Drive drive(75);
  test::PairLoop loop = drive.loop();
  for (int i = 0; i < 12; ++i) REQUIRE(drive.evaluate(loop, drive.pair(i)));
  REQUIRE(loop.state().verdict == Verdict::calibrated);
  const Skip silent{{ErrorCode::sensor_silent, "no image arrived"}};
  [[maybe_unused]] auto none = loop.decide(silent);
  CHECK(loop.state().verdict == Verdict::calibrated);
  none = loop.decide(silent);
  CHECK(loop.state().verdict == Verdict::not_evaluated);
  CHECK(loop.state().reason == "sensor_silent: no image arrived");
  CHECK(loop.state().skipped.at("sensor_silent") == 2);
  CHECK(loop.state().drift.verdict == DriftVerdict::calibrated);  // what was learned stays
}

TEST_CASE("what is decided depends on its arguments alone") {
  const Drive drive(76);
  test::PairLoop loop = drive.loop();
  for (int i = 0; i < 11; ++i) REQUIRE(drive.evaluate(loop, drive.pair(i)));
  test::PairLoop copy = loop;
  for (int i = 11; i < 16; ++i) {
    REQUIRE(drive.evaluate(loop, drive.pair(i, yaw(-1))));
    REQUIRE(drive.evaluate(copy, drive.pair(i, yaw(-1))));
    CHECK(to_text(loop.state()) == to_text(copy.state()));
  }
}
