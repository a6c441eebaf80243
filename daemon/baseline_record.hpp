#pragma once

#include "calib/drift.hpp"
#include "calib/record.hpp"

namespace calib {

/// The moments that a record says, of the running sums that the monitor keeps.
[[nodiscard]] CalibrationRecord::Baseline recorded(const DriftBaseline& baseline);
/// What a monitor goes on from that knows nothing but the record: the baseline, and no evidence since.
[[nodiscard]] DriftState learned_state(const CalibrationRecord::Baseline& recorded);

}  // namespace calib
