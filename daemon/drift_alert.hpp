#pragma once

#include <string>
#include <string_view>

#include "calib/status.hpp"

namespace calib {

/// A change of verdict. Mirrors proto/calibd.idl.
struct DriftAlert {
  WallTime stamp{};
  std::uint64_t alert_sequence = 0;
  std::string vehicle;
  std::string pair;
  Verdict verdict = Verdict::not_evaluated;
  Verdict previous_verdict = Verdict::not_evaluated;
  std::string reason;
  PairStatus::Misalignment misalignment;  // infinite sigma: not estimated
  std::uint64_t record_sequence = 0;
};

/// The form of proto/alert.schema.json.
[[nodiscard]] std::string alert_text(const DriftAlert& alert);
/// Its inverse. Fails with `malformed_alert`.
[[nodiscard]] Result<DriftAlert> parse_alert(std::string_view text);

}  // namespace calib
