#pragma once

#include "calib/drift.hpp"
#include "calib/record.hpp"

namespace calib {

/// Means, deviations and correlations, as a record has them, from the running sums of the drift monitor.
[[nodiscard]] CalibrationRecord::Baseline recorded(const DriftBaseline& baseline);
/// The state of a drift monitor that knows the record alone: its baseline, and no evidence since.
[[nodiscard]] DriftState learned_state(const CalibrationRecord::Baseline& recorded);

}  // namespace calib
