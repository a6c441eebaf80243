#pragma once

#include <string>
#include <vector>

#include "config.hpp"

namespace calib {

/// Keys whose values a new configuration changes, such as `sampling.period`, sorted.
struct ConfigChanges {
  std::vector<std::string> taken_over;
  std::vector<std::string> need_restart;
};

/// Makes of `running` what `wanted` says, as far as no state is lost by that: thresholds, modes and intervals. What
/// decides which data are evidence, or what calibd is connected to, needs a restart and stays as it is. Keys of pairs
/// are compared by position; where pairs were added, removed, renamed or moved, everything about pairs needs a restart.
ConfigChanges take_over(const Config& wanted, Config& running);

}  // namespace calib
