#pragma once

#include <string>
#include <vector>

#include "calib/status.hpp"
#include "commands.hpp"

namespace calib::ctl {

/// Whether the extrinsic of a pair is that of its record, which is signed and part of an unbroken chain.
struct RecordCheck {
  /// False: calibctl could not verify it itself (no store, no public key). Then `verified` is what the running daemon
  /// says.
  bool checked = false;
  bool verified = false;
  /// The result in words.
  std::string words;
};

/// One per pair of `status`, in the same order. A pair without a record is never verified.
[[nodiscard]] std::vector<RecordCheck> check_records(const Status& status, const Paths& paths);

}  // namespace calib::ctl
