#pragma once

#include <chrono>
#include <string>
#include <string_view>

#include "calib/result.hpp"

namespace calib {

/// Wall time, nanoseconds since the UNIX epoch. Leap seconds are not counted.
using WallTime = std::chrono::nanoseconds;

/// RFC 3339, UTC, milliseconds (rounded down): `2026-01-31T12:00:00.000Z`.
[[nodiscard]] std::string rfc3339(WallTime time);

/// The same with nine decimals, so that `parse_rfc3339` gives `time` back exactly.
[[nodiscard]] std::string rfc3339_ns(WallTime time);

/// Inverse of both, for any number of decimals from 0 to 9 and `Z` only; years 1678 to 2261.
/// Fails with `bad_time`.
[[nodiscard]] Result<WallTime> parse_rfc3339(std::string_view text);

}  // namespace calib
