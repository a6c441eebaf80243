#pragma once

#include <filesystem>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "calib/status.hpp"
#include "calib/store.hpp"
#include "chain_head.hpp"
#include "clock.hpp"
#include "evidence_file.hpp"
#include "feed.hpp"
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

/// The signed history of decisions, and what else must survive a restart. What belongs to one decision (record, state,
/// alert and what the fleet is told of it) is written in one transaction: after a crash either all of it is there or
/// nothing. Evidence that has
/// decided nothing is written beside the store, for all pairs at once: it follows the state of the pair's last
/// decision, and counts as long as that is the one in the store.
class Ledger {
 public:
  /// Opens `state_dir`/calibd.db and verifies every record in it. Fails when a record does not verify, and leaves the
  /// store as it is. Fails with `other_vehicle` when the records are of another vehicle than `provenance`: a chain
  /// holds the records of one vehicle. The head of the chain is kept in `head_dir`.
  ///
  /// A `key` that is not the one with which the chain ends opens the ledger, too, as one that refuses to sign
  /// (`signing_refused`). Its history is that of the records if they verify with `key` or with `trusted`, and empty if
  /// they do not.
  [[nodiscard]] static Result<Ledger> open(const std::filesystem::path& state_dir,
                                           const std::filesystem::path& head_dir, SigningKey key, Provenance provenance,
                                           FeedSettings feed = {}, const std::optional<PublicKey>& trusted = {});

  /// The records of a pair, by what they are needed for; empty before its first record.
  [[nodiscard]] const PairHistory& history(std::string_view pair) const;
  /// Fails with `record_not_found`, also for a record of another pair.
  [[nodiscard]] Result<CalibrationRecord> find(std::string_view pair, std::uint64_t sequence) const;
  /// What one decision writes beside the state. Of `record` the decision, reason, asked_by, the extrinsics and what was
  /// computed have to be set; `write` fills in the rest.
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
  /// Writes the entry and the pair's state in one transaction. While signing is refused, fails with `wrong_key` for a
  /// record, but for an `initial` one, which counts unsigned and with number 0 until the end of the process; and writes
  /// no state, which would have to be authenticated.
  [[nodiscard]] Result<Written> write(std::string_view pair, const PairState& state, Entry entry, const Moment& now);

  /// Writes the states of pairs that have new evidence since their last `write`: all of them, also those that were
  /// written by the call before. Durable when it returns.
  [[nodiscard]] Result<void> write_evidence(const std::map<std::string_view, const PairState*>& states);
  /// Why records are not signed: the key is not the one with which the chain ends. A sentence with the remedy.
  [[nodiscard]] const std::optional<std::string>& signing_refused() const { return signing_refused_; }
  struct NewKey {
    /// The next one; none: this process' own, in the place of the one with which the chain ends, which is lost.
    std::optional<SigningKey> key;
    std::optional<std::uint64_t> doubted_from;
    std::string asked_by;
    Comment comment;
  };
  /// Writes a record of decision `key_changed`, and the states of the pairs for the next key, in one transaction. From
  /// then on that key signs. Fails with `bad_request` for a key that the chain has had, for one that is not lost, and
  /// for records that cannot be doubted; with `wrong_key` while signing is refused for another reason than a lost key.
  [[nodiscard]] Result<CalibrationRecord> change_key(NewKey request,
                                                     const std::map<std::string_view, const PairState*>& states,
                                                     const Moment& now);

  /// Whether `write` would find the store in its place and unlocked, and room on the disk. Writes nothing.
  [[nodiscard]] Result<void> is_writable();

  /// The state that was written last; nothing when there is none. Fails with `malformed_state` when its MAC is wrong,
  /// or when it belongs to another chain of records, or to the same chain before or after its present end.
  [[nodiscard]] Result<std::optional<PairState>> state(std::string_view pair) const;
  /// The latest alerts, oldest first, and the errors of those that cannot be read.
  struct Alerts {
    std::vector<DriftAlert> alerts;
    std::vector<Error> unreadable;
  };
  [[nodiscard]] Result<Alerts> latest_alerts(std::size_t limit) const;

  /// What the fleet is told without a decision: `what` writes it, in one transaction. Fails with `wrong_key` while
  /// signing is refused.
  [[nodiscard]] Result<void> tell(const std::function<Result<void>(Feed&, const Feed::Writer&)>& what,
                                  const Moment& now);
  [[nodiscard]] const Feed& feed() const { return feed_; }
  /// Events up to and including `sequence` were received.
  [[nodiscard]] Result<void> acknowledge(std::uint64_t sequence);
  [[nodiscard]] std::uint64_t waiting_event_count() const { return waiting_events_; }
  [[nodiscard]] std::string key_id() const { return key_.public_key().id_text(); }
  /// Of the key that has signed a record.
  [[nodiscard]] std::string key_id(std::uint64_t sequence) const { return period_of(sequence, periods_).key.id_text(); }
  [[nodiscard]] const Provenance& provenance() const { return provenance_; }

  /// The configuration that later records name.
  void set_configuration(std::string sha256) { provenance_.configuration_sha256 = std::move(sha256); }

  /// A sentence about records that had been written and are missing from the store. The next record contains it, too.
  [[nodiscard]] const std::optional<std::string>& records_missing() const { return records_missing_; }
  /// Why evidence of later than the last decisions could not be read; the states of those decisions count.
  [[nodiscard]] const std::optional<Error>& evidence_failure() const { return evidence_failure_; }
  /// Why the head of the chain could not be written; each `write` tries again. The records themselves are written.
  [[nodiscard]] const std::optional<Error>& head_failure() const { return head_failure_; }

 private:
  Ledger(Store store, std::filesystem::path state_dir, std::filesystem::path head_dir, SigningKey key,
         Provenance provenance, FeedSettings feed);
  void index(CalibrationRecord record);
  // ledger_keys.cpp
  [[nodiscard]] Result<std::vector<CalibrationRecord>> read_records(const std::optional<PublicKey>& trusted);
  [[nodiscard]] Result<Written> write_unsigned(std::string_view pair, Entry entry, const Moment& now);
  [[nodiscard]] Result<CalibrationRecord> key_change(const NewKey& request) const;
  void doubt_records();

  [[nodiscard]] Result<std::string> sha256_of(std::uint64_t sequence) const;
  [[nodiscard]] Result<void> compare_with_head();
  [[nodiscard]] std::optional<std::string> missing_from(const ChainHead& remembered) const;
  void complete(CalibrationRecord& record, std::string_view pair, const Moment& now) const;
  [[nodiscard]] static std::string authenticated(const SigningKey& key, std::string_view pair, std::uint64_t sequence,
                                                 std::string_view sha256, const PairState& state);
  void write_head();
  void count_waiting_events();

  Store store_;
  std::filesystem::path state_dir_, head_dir_;
  SigningKey key_;
  Provenance provenance_;
  Feed feed_;
  std::uint64_t waiting_events_ = 0;
  std::optional<std::string> signing_refused_;
  std::vector<KeyPeriod> periods_;  // none where the records cannot be verified
  std::uint64_t last_sequence_ = 0;
  std::string last_sha256_{no_previous_sha256};
  ChainHead head_;  // as remembered
  std::optional<Error> head_failure_;
  Evidence evidence_;  // as it was read; its number is that of the last write
  std::optional<Error> evidence_failure_;
  std::optional<std::string> records_missing_;
  bool written_by_first_version_ = false;  // the last record: its calibd remembered no head
  std::map<std::string, std::uint64_t, std::less<>> last_of_pair_;
  std::map<std::string, PairHistory, std::less<>> histories_;
};

}  // namespace calib
