#pragma once

#include <cstdint>
#include <optional>
#include <string_view>

#include "calib/result.hpp"

namespace calib {

/// Why calibd cannot take part in a DDS domain, by what the system says: no such interface, an interface that is down
/// or has no address, a port that another program keeps to itself, no permission. The error names the key of the
/// configuration. Nothing when none of these is seen. Opens sockets for a moment and sends nothing; a calibd that runs,
/// and any other DDS program, shares its ports and is no obstacle.
/// `by_multicast`: whether participants find each other by it.
[[nodiscard]] std::optional<Error> obstacle_to_domain(std::uint32_t domain, std::string_view interface,
                                                      bool by_multicast);

}  // namespace calib
