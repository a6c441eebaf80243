#pragma once

#include <string>
#include <vector>

#include "config.hpp"

namespace calib {

/// What calibd would refuse at its start, beyond what parsing shows: a signing key that the file names and that is
/// missing, public, readable by others or damaged, and files of a depth source. Fails with the first. A key that this
/// user may not read is not checked, nor is one that the service manager will pass.
[[nodiscard]] Result<void> check_files(const Config& config);

/// What calibd takes and is almost surely a slip, a sentence each that names the key: a principal point outside the
/// image, focal lengths that differ much, a camera that is further from the LiDAR than a vehicle is long.
[[nodiscard]] std::vector<std::string> probable_slips(const Config& config);

}  // namespace calib
