#pragma once

#include <array>
#include <functional>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>

#include "config.hpp"
#include "ledger.hpp"
#include "pair_monitor.hpp"

namespace calib {

/// Whom a pair's watch tells what has happened, once it is written down.
struct PairListener {
  std::function<void(const DriftAlert&)> alert;
  /// One line for the journal: syslog's priority, message id (message_ids.hpp), text.
  std::function<void(int priority, std::string_view message_id, const std::string& text)> journal;
  /// The extrinsic in force, or the one proposed, is another.
  std::function<void()> extrinsic_changed;
  /// Called often while a recalibration goes on; false ends it.
  std::function<bool()> keep_going = [] { return true; };
};

/// The life of one camera-LiDAR pair: evidence becomes verdicts, verdicts become alerts and new extrinsics, and every
/// decision is in the ledger before it counts. Knows no DDS, and of the time what `clock` says; not thread-safe.
class PairWatch {
 public:
  using Clock = std::function<Moment()>;
  /// Windows without evidence after which the last verdict no longer counts.
  static constexpr int windows_to_stale = 2;

  /// Takes over what the ledger remembers: the extrinsic that the last record put in force, unless the configuration
  /// has a new one since; for that an `initial` record is written. Evidence is taken over when it was measured with
  /// what `evidence_sha256` is the digest of, and set aside otherwise. `config`, `pair` (one of its pairs) and `ledger`
  /// outlive the watch.
  [[nodiscard]] static Result<std::unique_ptr<PairWatch>> take_over(const Config& config, const PairConfig& pair,
                                                                    std::string evidence_sha256,
                                                                    std::unique_ptr<DepthEstimator> depth,
                                                                    Ledger& ledger, Clock clock, PairListener listener);

  // One window of sampling ends in `evaluate`, or in `observe` or `skip`; then in `conclude`.

  /// Fails with the reason why this pair says nothing, for `skip`.
  [[nodiscard]] Result<void> evaluate(const FramePair& pair);
  /// Takes evidence that was measured at the extrinsic in force, by `evaluate` or before, on samples that were received
  /// at `taken`.
  void observe(PairMonitor::Evidence evidence, const Moment& taken);
  /// A window without evidence, or as good as `windows` of them.
  void skip(const Error& error, int windows = 1);
  /// Counts a sample that was of no use; `skip` does so itself with what no message was refused for.
  void count_skipped(ErrorCode code) { ++state_.skipped[std::string(to_string(code))]; }
  /// From the evidence so far to a verdict, with the alert that it calls for; to the end of a probation, a baseline, or
  /// a new extrinsic.
  void conclude();

  // What is asked for at the control socket, answered as proto/control.md has it.

  [[nodiscard]] nlohmann::json recalibrate(const std::string& asked_by, bool dry_run);
  /// Puts the proposed extrinsic in force.
  [[nodiscard]] nlohmann::json accept(const std::string& asked_by);
  /// Puts an earlier extrinsic in force: of record `to`, or (null) the one before the present one.
  [[nodiscard]] nlohmann::json roll_back(const nlohmann::json& to, const std::string& asked_by);

  /// All that the watch knows; its sensors' inputs are left out.
  [[nodiscard]] PairStatus status() const;
  /// The proposed extrinsic, or the one in force when it is not the configuration's.
  [[nodiscard]] std::optional<RigidTransform> computed_extrinsic() const;
  [[nodiscard]] const PairState& state() const { return state_; }
  [[nodiscard]] const PairMonitor& monitor() const { return monitor_; }
  [[nodiscard]] const PairConfig& config() const { return pair_; }
  /// Why the last write to the store failed; nothing when it did not.
  [[nodiscard]] const std::optional<Error>& store_failure() const { return store_failure_; }
  /// Why the last window without evidence had none.
  [[nodiscard]] const std::string& last_skip() const { return last_skip_; }

 private:
  PairWatch(const Config& config, const PairConfig& pair, std::string evidence_sha256, PairMonitor monitor,
            PairState state, Ledger& ledger, Clock clock, PairListener listener);

  void begin(const std::string& set_aside);
  [[nodiscard]] BootTime boot_time() const { return {ledger_.provenance().boot_id, clock_().since_boot}; }
  [[nodiscard]] std::optional<std::string> not_written() const;
  [[nodiscard]] std::optional<Grounds> grounds(std::optional<std::string> not_written) const;
  [[nodiscard]] PairState concluded() const;
  [[nodiscard]] DriftAlert alert(const PairState& after) const;
  bool write(PairState after, std::optional<CalibrationRecord> record, const std::function<void()>& adopt = {});
  [[nodiscard]] std::optional<CalibrationRecord> baseline_due() const;

  // pair_watch_decisions.cpp
  [[nodiscard]] bool may_recalibrate() const;
  void refuse(PairState& after) const;
  [[nodiscard]] Result<PairMonitor::Outcome> try_to_recalibrate() const;
  [[nodiscard]] nlohmann::json put_in_force(CalibrationRecord record, PairState after);
  [[nodiscard]] std::string patience() const;
  [[nodiscard]] bool stands_probation();
  void return_from_probation(const std::string& why);
  [[nodiscard]] const std::string& name() const { return pair_.name; }

  const Config& config_;
  const PairConfig& pair_;
  PairMonitor monitor_;
  PairState state_;
  Ledger& ledger_;
  Clock clock_;
  PairListener listener_;
  const std::string evidence_sha256_;
  // Evidence of this process, at the extrinsic in force.
  std::uint64_t pairs_ = 0;
  BootTime taken_;
  std::array<std::chrono::nanoseconds, 2> cycles_{};  // between the latest windows
  std::optional<std::chrono::nanoseconds> last_window_;
  int windows_without_evidence_ = 0;
  std::string last_skip_;
  std::optional<Error> store_failure_;  // of the last write
  std::uint64_t retry_at_ = 0;  // value of `state.evaluated` from which the next recalibration may run
};

}  // namespace calib
