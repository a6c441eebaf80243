#pragma once

#include <nlohmann/json_fwd.hpp>
#include <string>

#include "network_check.hpp"

namespace calib::ctl {

/// Lines for a person.
[[nodiscard]] std::string report_text(const NetworkReport& report, const NetworkFrame& frame);
/// The same for a program; calibctl(1) describes it.
[[nodiscard]] nlohmann::json report_json(const NetworkReport& report, const NetworkFrame& frame);

}  // namespace calib::ctl
