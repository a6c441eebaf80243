#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "calib/store.hpp"
#include "commands.hpp"

namespace calib::ctl {

/// The records of the store up to the first that does not verify, and why that one does not.
struct Chain {
  struct Link {
    CalibrationRecord record;
    SignedRecord bytes;
  };
  PublicKey key;                     // that is trusted
  std::vector<KeyPeriod> periods{};  // of an unbroken chain
  std::vector<Link> verified{};
  std::uint64_t stored = 0;
  std::optional<Error> broken{};

  /// Of the key that has signed a verified record.
  [[nodiscard]] std::string key_id(std::uint64_t sequence) const;
  /// `key A`, or `keys A (records 1 to 5) and B (records 6 to 9)`.
  [[nodiscard]] std::string keys() const;
};

/// Whether this user lacks the permission to read the store.
[[nodiscard]] bool only_daemon_may_read(const Paths& paths);

/// Reads the store, or requests the records from calibd if this user may not read it. Every record is verified. The
/// chain also counts as broken when it ends before the record that calibd noted outside the store as the last one.
[[nodiscard]] Result<Chain> read_chain(const Paths& paths);

}  // namespace calib::ctl
