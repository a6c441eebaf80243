#pragma once

#include "calib/frame.hpp"

namespace calib {

/// One-sided cumulative sum chart (Page 1954): detects a lasting shift of a sequence's mean. It gives an
/// alarm when its sum reaches a limit, the decision interval, that the caller derives with `cusum_limit` and passes to
/// each call.
struct Cusum {
  /// An update counts for no more than this share of the limit, so that no two values alone give an alarm.
  static constexpr double max_update_share = 0.36;
  /// The sum grows no further than to this share of the limit, so that a shift that lasted long and ends clears as soon
  /// as a short one.
  static constexpr double cap_share = 1.2;

  double sum = 0;
  /// Stamp of the pair that began the present run of evidence: the estimated onset of the shift, should it be one. It
  /// means nothing while `sum` is zero.
  Timestamp onset{};

  /// `value`: the deviation from the mean towards this chart's side, less the reference value, in standard deviations
  /// of one value. `limit` is positive.
  void update(double value, Timestamp stamp, double limit);
  /// Evidence of a shift, 0 .. `cap_share`; from 1 on it is an alarm.
  [[nodiscard]] double share(double limit) const { return sum / limit; }

  bool operator==(const Cusum&) const = default;
};

/// The limit at which a chart of independent standard normal values, less the reference value `k` > 0, gives an alarm
/// by chance once in `average_run_length` values (Siegmund 1985, Eq. 2.56).
[[nodiscard]] double cusum_limit(double k, double average_run_length);

}  // namespace calib
