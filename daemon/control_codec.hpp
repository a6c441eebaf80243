#pragma once

#include <nlohmann/json_fwd.hpp>

#include "diagnosis.hpp"

namespace calib {

/// The answer to the request `doctor`, as proto/control.md has it. Control characters of quoted text are escaped.
[[nodiscard]] nlohmann::json to_json(const DiagnosisReport& report);

}  // namespace calib
