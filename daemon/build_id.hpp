#pragma once

#include <string>

#include "calib/result.hpp"

namespace calib {

[[nodiscard]] Result<std::string> build_id();

}  // namespace calib
