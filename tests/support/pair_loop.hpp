#pragma once

#include "pair_pipeline.hpp"

namespace calib::test {

/// A pair's pipeline in memory: what it decides counts at once, without a store, and time stands still.
class PairLoop {
 public:
  PairLoop(PairSettings settings, const RigidTransform& T_camera_lidar, DriftState drift = {})
      : pipeline_(std::move(settings)) {
    CalibrationRecord record;
    record.decision = Decision::initial;
    record.sequence = 1;
    record.T_camera_lidar = record.T_camera_lidar_before = T_camera_lidar;
    state_.put_in_force(record);
    history_.add(std::move(record));
    state_.drift = std::move(drift);
  }

  [[nodiscard]] Result<Measurement> measure(const FramePair& pair, DepthEstimator& depth) const {
    auto measurement = pipeline_.measure(pair, state_, depth);
    if (measurement) measurement->received = now().time.since_boot;
    return measurement;
  }
  template <typename Event>
  Result<Answer> decide(Event event) {
    return take(pipeline_.decide(state_, std::move(event), now()));
  }
  /// Measures and decides; fails with the reason why the pair carries no information.
  Result<void> evaluate(const FramePair& pair, DepthEstimator& depth) {
    auto measurement = measure(pair, depth);
    if (!measurement) return propagate(measurement);
    [[maybe_unused]] const auto none = decide(std::move(*measurement));
    return {};
  }

  Result<Answer> recalibrate(bool dry_run = false) {
    return decide(Recalibrate{.asked_by = "test", .dry_run = dry_run, .found = pipeline_.search(state_, {})});
  }
  /// Whether enough pairs are at hand.
  [[nodiscard]] bool can_recalibrate() const {
    const auto found = pipeline_.search(state_, [] { return false; });
    return found || found.error().code != ErrorCode::not_ready;
  }

  [[nodiscard]] const PairState& state() const { return state_; }
  [[nodiscard]] const PairHistory& history() const { return history_; }
  [[nodiscard]] DriftMonitor monitor() const { return DriftMonitor(pipeline_.settings().drift, state_.drift); }
  [[nodiscard]] PairStatus status() const { return pipeline_.status(state_, std::nullopt, now()); }

 private:
  [[nodiscard]] Now now() const {
    return {.time = {std::chrono::seconds(1'800'000'000), std::chrono::seconds(100)},
            .boot_id = "boot",
            .history = history_,
            .next_sequence = history_.extrinsics.size() + history_.baselines.size() + 1};
  }
  Result<Answer> take(PairDecision decision) {
    if (decision.state) state_ = std::move(*decision.state);
    if (decision.record) {
      decision.record->sequence = now().next_sequence;
      history_.add(std::move(*decision.record));
      state_.put_in_force(*history_.in_force());
    }
    return std::move(decision.answer);
  }

  PairPipeline pipeline_;
  PairState state_;
  PairHistory history_;
};

}  // namespace calib::test
