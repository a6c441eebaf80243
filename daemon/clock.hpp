#pragma once

#include <chrono>
#include <functional>

#include "calib/wall_time.hpp"

namespace calib {

/// Now, by both clocks that a record names: since 1970 (UTC), and since the machine was started (CLOCK_BOOTTIME).
struct Moment {
  WallTime wall{};
  std::chrono::nanoseconds since_boot{};
};

/// May be called from any thread.
using Clock = std::function<Moment()>;
[[nodiscard]] Moment system_clock();

}  // namespace calib
