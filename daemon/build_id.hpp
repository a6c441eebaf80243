#pragma once

#include <string>

#include "calib/result.hpp"

namespace calib {

/// The GNU build id of the running program, lower-case hex: a hash over its linked contents, which stripping debug
/// information does not change. Fails with `no_build_id` when the program was linked without one.
[[nodiscard]] Result<std::string> build_id();

}  // namespace calib
