#pragma once

#include <optional>
#include <vector>

#include "calib/store.hpp"
#include "commands.hpp"

namespace calib::ctl {

/// The records of the store up to the first that does not verify, and what is wrong with that one.
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

/// Whether this user may not read the store itself.
[[nodiscard]] bool only_daemon_may_read(const Places& places);

/// Reads the store; where only calibd may do that, asks it. Nothing that comes is believed before it is verified. The
/// chain is broken, too, when it ends before the record that calibd remembers, beside the store, as the last one.
[[nodiscard]] Result<Chain> read_chain(const Places& places);

}  // namespace calib::ctl
