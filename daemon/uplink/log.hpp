#pragma once

#include <string>

namespace calib::uplink {

/// A line on standard error with syslog's priority, which the journal understands; control characters are escaped.
void log(int priority, const std::string& line);

}  // namespace calib::uplink
