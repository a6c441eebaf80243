#pragma once

#include <string>
#include <vector>

#include "calib/status.hpp"
#include "calib/store.hpp"
#include "commands.hpp"

namespace calib::ctl {

/// The store, read only. SQLite would wait for a FIFO in the place of one of its files: that fails with `store_failed`.
[[nodiscard]] Result<Store> open_store(const Places& places);

/// Whether a pair's extrinsic is the one that its record says, signed and in an unbroken chain.
struct RecordCheck {
  /// False: calibctl could not look (no store, no public key); then `verified` is the running daemon's word.
  bool checked = false;
  bool verified = false;
  /// What was found, in words.
  std::string words;
};

/// One per pair of `status`, in its order. A pair without a record is never verified.
[[nodiscard]] std::vector<RecordCheck> check_records(const Status& status, const Places& places);

}  // namespace calib::ctl
