#pragma once

#include <string>

#include "uplink/delivery.hpp"

namespace calib::uplink {

/// In Prometheus' text format, for node_exporter's textfile collector.
[[nodiscard]] std::string metrics_text(const Delivery::Figures& figures);

}  // namespace calib::uplink
