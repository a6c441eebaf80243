#pragma once

#include <string>

#include "calib/result.hpp"

namespace calib {

/// The GNU build id of the running program, as lower-case hex: what its linker made of all that it was linked from, the
/// same in a copy whose debug information was stripped. Fails with `no_build_id` when it was linked without one.
[[nodiscard]] Result<std::string> build_id();

}  // namespace calib
