#pragma once

#include "calib/result.hpp"

namespace calib {

/// Checks at the start that calibd may open as many files as it can ever need at once, by opening and closing them:
/// Cyclone DDS may crash where it runs out of them. Fails with `too_few_files`.
[[nodiscard]] Result<void> require_open_files();

}  // namespace calib
