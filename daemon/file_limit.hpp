#pragma once

#include "calib/result.hpp"

namespace calib {

/// Opens as many files as calibd may ever have open at once beside those it was started with, and closes them again:
/// Cyclone DDS does not survive every way of running out of them. Fails with `too_few_files`.
[[nodiscard]] Result<void> require_open_files();

}  // namespace calib
