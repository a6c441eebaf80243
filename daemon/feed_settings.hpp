#pragma once

#include <chrono>

namespace calib {

/// How often the fleet is told of a pair's verdict.
struct FeedSettings {
  /// After a change of a pair's verdict was told, further ones are held for so long; then the last of them is told.
  /// `confirmed` is never held.
  std::chrono::nanoseconds debounce = std::chrono::minutes(10);
  /// How long a pair is without a verdict, in one run of calibd, before that is told.
  std::chrono::nanoseconds unavailable_after = std::chrono::hours(2);
};

}  // namespace calib
