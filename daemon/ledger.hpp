#pragma once

#include <filesystem>
#include <map>
#include <optional>
#include <string>

#include "calib/status.hpp"
#include "calib/store.hpp"
#include "dds/messages.hpp"
#include "pair_state.hpp"

namespace calib {

/// What stands in every record and does not change while the daemon runs.
struct Provenance {
  std::string vehicle;
  std::string configuration_sha256;
  std::string software_version;
  std::string software_sha256;
  std::string boot_id;
};

/// Now, by both clocks that a record names.
struct Moment {
  WallTime wall{};
  std::chrono::nanoseconds since_boot{};
};

/// Whether two extrinsics differ by no more than rounding.
[[nodiscard]] bool same(const RigidTransform& a, const RigidTransform& b);

/// The signed history of decisions, and what else must survive a restart. Decisions, state and alerts that belong
/// together are written together: after a crash either all of them happened or none.
class Ledger {
 public:
  /// Opens `state_dir`/calibd.db and verifies every record in it. Fails when one does not verify: nothing is to be
  /// trusted then, and nothing is overwritten.
  [[nodiscard]] static Result<Ledger> open(const std::filesystem::path& state_dir, SigningKey key,
                                           Provenance provenance);

  /// The last record that put an extrinsic in force for the pair (decision initial, accepted or rolled_back).
  [[nodiscard]] const CalibrationRecord* in_force(std::string_view pair) const;
  /// The last `initial` record: what the configuration said when it was last taken over.
  [[nodiscard]] const CalibrationRecord* initial(std::string_view pair) const;
  /// Fails with `record_not_found`, also for a record of another pair.
  [[nodiscard]] Result<CalibrationRecord> find(std::string_view pair, std::uint64_t sequence) const;
  /// The record that was in force before the present one, if any.
  [[nodiscard]] const CalibrationRecord* before_in_force(std::string_view pair) const;

  /// The last `baseline` record of an extrinsic, or of the one in force: also from an earlier time when it was.
  [[nodiscard]] const CalibrationRecord* baseline(std::string_view pair, const RigidTransform& T_camera_lidar) const;
  [[nodiscard]] const CalibrationRecord* baseline(std::string_view pair) const;

  /// Everything that one event changes. `record` needs only pair, decision, reason, asked_by, the extrinsics and what
  /// was computed: the rest is filled in.
  struct Entry {
    std::optional<CalibrationRecord> record;
    std::optional<DriftAlert> alert;
  };
  struct Written {
    std::optional<CalibrationRecord> record;
    std::optional<DriftAlert> alert;  // with its sequence
  };
  /// The sequence that the next record gets.
  [[nodiscard]] std::uint64_t next_sequence() const { return last_sequence_ + 1; }
  /// Writes the entry and the pair's state in one transaction.
  [[nodiscard]] Result<Written> write(std::string_view pair, const PairState& state, Entry entry, const Moment& now);

  [[nodiscard]] Result<std::optional<PairState>> state(std::string_view pair) const;
  /// Alerts that nobody has taken yet, oldest first.
  [[nodiscard]] Result<std::vector<DriftAlert>> waiting_alerts(std::size_t limit) const;
  [[nodiscard]] std::uint64_t waiting_alert_count() const;
  [[nodiscard]] std::string key_id() const { return key_.public_key().id_text(); }

 private:
  Ledger(Store store, SigningKey key, Provenance provenance);
  void index(CalibrationRecord record);

  Store store_;
  SigningKey key_;
  Provenance provenance_;
  std::uint64_t last_sequence_ = 0;
  std::string last_sha256_{no_previous_sha256};
  std::map<std::string, std::vector<CalibrationRecord>, std::less<>> extrinsics_;  // those that came into force
  std::map<std::string, CalibrationRecord, std::less<>> initial_;
  std::map<std::string, std::vector<CalibrationRecord>, std::less<>> baselines_;
};

}  // namespace calib
