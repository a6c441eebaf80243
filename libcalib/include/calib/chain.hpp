#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "calib/record.hpp"

namespace calib {

/// The records that a key signs, by number: the chain itself says so, from the key that its reader trusts.
struct KeyPeriod {
  PublicKey key;
  std::uint64_t from = 1;
  /// The record that names the key after it; nothing while this one is valid.
  std::optional<std::uint64_t> until{};
  /// From here to before `until` somebody else may have signed.
  std::optional<std::uint64_t> doubted_from{};

  [[nodiscard]] bool holds(std::uint64_t sequence) const { return from <= sequence && (!until || sequence <= *until); }
  [[nodiscard]] bool doubts(std::uint64_t sequence) const {
    return doubted_from && *doubted_from <= sequence && sequence < until.value_or(0);
  }
};

/// The period in which a record stands; they have no gap. `periods` of `visit_verified`.
[[nodiscard]] const KeyPeriod& period_of(std::uint64_t sequence, const std::vector<KeyPeriod>& periods);

/// Reads a record by its number. Fails with `record_not_found`.
using RecordOf = std::function<Result<SignedRecord>(std::uint64_t sequence)>;

/// Where the trust in a key leads to in a chain: to the key of its first record, by the changes of keys that the
/// trusted one, and those before it, have signed. They bind every record before them by its hash.
struct Anchor {
  PublicKey first;
  /// Those changes, by the number of their records.
  std::map<std::uint64_t, KeyChange> vouched{};
};
[[nodiscard]] Anchor find_anchor(std::uint64_t count, const RecordOf& record_of, const PublicKey& trusted);

/// Verifies the records of a chain from the first to the last, across changes of keys. A key that has gone does not
/// come back.
class ChainVerifier {
 public:
  explicit ChainVerifier(Anchor anchor) : vouched_(std::move(anchor.vouched)), periods_{{.key = anchor.first}} {}

  /// The next record, if it is one. Fails as `verify_record`; and with `wrong_key` for one that a key has signed
  /// that is not valid any more.
  [[nodiscard]] Result<CalibrationRecord> next(const SignedRecord& record);
  /// The last one is valid for the next record.
  [[nodiscard]] const std::vector<KeyPeriod>& periods() const { return periods_; }

 private:
  [[nodiscard]] Result<CalibrationRecord> verify(const SignedRecord& record) const;
  [[nodiscard]] Result<void> may_change(const KeyChange& change) const;
  [[nodiscard]] Error explained(const SignedRecord& record, Error error) const;

  std::map<std::uint64_t, KeyChange> vouched_;
  std::vector<KeyPeriod> periods_;
  std::uint64_t last_sequence_ = 0;
  std::string last_sha256_{no_previous_sha256};
};

/// Shows `visit` records 1 to `count`, oldest first, each once it is verified, beginning with a `trusted` key: that of
/// the first record, or any later one. Returns the periods of the keys. Fails at the first record that does not verify
/// or is missing, naming its sequence; those before it have been shown.
[[nodiscard]] Result<std::vector<KeyPeriod>> visit_verified(
    std::uint64_t count, const RecordOf& record_of, const PublicKey& trusted,
    const std::function<void(const CalibrationRecord&, const SignedRecord&)>& visit);

/// The one or two signature files of a record: the second is empty unless it is a change of keys.
struct Signatures {
  std::string_view first, second;
};
[[nodiscard]] Signatures split_signatures(std::string_view text);

}  // namespace calib
