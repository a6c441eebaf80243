#pragma once

#include <optional>
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
  PublicKey key;
  std::vector<Link> verified;
  std::uint64_t stored = 0;
  std::optional<Error> broken;
};

/// Whether this user lacks the permission to read the store.
[[nodiscard]] bool only_daemon_may_read(const Paths& paths);

/// Reads the store, or requests the records from calibd if this user may not read it. Every record is verified. The
/// chain also counts as broken when it ends before the record that calibd noted outside the store as the last one.
[[nodiscard]] Result<Chain> read_chain(const Paths& paths);

}  // namespace calib::ctl
