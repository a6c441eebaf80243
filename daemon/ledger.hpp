#pragma once

#include <filesystem>
#include <map>
#include <optional>
#include <string>

#include "calib/status.hpp"
#include "calib/store.hpp"
#include "chain_head.hpp"
#include "clock.hpp"
#include "drift_alert.hpp"
#include "pair_history.hpp"
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

/// The signed history of decisions, and what else must survive a restart. Decisions, state and alerts that belong
/// together are written together: after a crash either all of them happened or none.
class Ledger {
 public:
  /// Opens `state_dir`/calibd.db and verifies every record in it. Fails when one does not verify: nothing is to be
  /// trusted then, and nothing is overwritten. Fails with `other_vehicle` when the records are of another vehicle than
  /// `provenance`: one chain holds one. `head_dir` is where the chain's head is remembered.
  [[nodiscard]] static Result<Ledger> open(const std::filesystem::path& state_dir,
                                           const std::filesystem::path& head_dir, SigningKey key,
                                           Provenance provenance);

  /// What the records say of a pair; nothing of one that has none yet.
  [[nodiscard]] const PairHistory& history(std::string_view pair) const;
  /// Fails with `record_not_found`, also for a record of another pair.
  [[nodiscard]] Result<CalibrationRecord> find(std::string_view pair, std::uint64_t sequence) const;
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

  /// What was written last, authenticated, and in keeping with the records: none of them, and none that was there when
  /// it was written, may be missing. Fails with `malformed_state` otherwise.
  [[nodiscard]] Result<std::optional<PairState>> state(std::string_view pair) const;
  /// The latest alerts that nobody has taken yet, oldest first, less those that cannot be read.
  struct Alerts {
    std::vector<DriftAlert> alerts;
    std::vector<Error> unreadable;
  };
  [[nodiscard]] Result<Alerts> latest_alerts(std::size_t limit) const;
  [[nodiscard]] std::uint64_t waiting_alert_count() const;
  [[nodiscard]] std::string key_id() const { return key_.public_key().id_text(); }
  [[nodiscard]] const Provenance& provenance() const { return provenance_; }

  /// Records that had been written and were not in the store when it was opened, in words. The next record says so too.
  [[nodiscard]] const std::optional<std::string>& records_missing() const { return records_missing_; }
  /// Why the chain's head could not be remembered; tried again with each `write`. The records themselves are written.
  [[nodiscard]] const std::optional<Error>& head_failure() const { return head_failure_; }

 private:
  Ledger(Store store, std::filesystem::path head_dir, SigningKey key, Provenance provenance);
  void index(CalibrationRecord record);
  [[nodiscard]] Result<std::string> sha256_of(std::uint64_t sequence) const;
  [[nodiscard]] Result<void> compare_with_head();
  [[nodiscard]] Result<SignedRecord> complete(CalibrationRecord& record, std::string_view pair,
                                              const Moment& now) const;
  [[nodiscard]] std::string authenticated(std::string_view pair, std::uint64_t sequence, std::string_view sha256,
                                          const PairState& state) const;
  void write_head();

  Store store_;
  std::filesystem::path head_dir_;
  SigningKey key_;
  Provenance provenance_;
  std::uint64_t last_sequence_ = 0;
  std::string last_sha256_{no_previous_sha256};
  ChainHead head_;  // as remembered
  std::optional<Error> head_failure_;
  std::optional<std::string> records_missing_;
  bool written_by_first_version_ = false;  // the last record: its calibd remembered no head
  std::map<std::string, std::uint64_t, std::less<>> last_of_pair_;
  std::map<std::string, PairHistory, std::less<>> histories_;
};

}  // namespace calib
