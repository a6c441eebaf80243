#pragma once

#include <string_view>

namespace calib {

/// One logged change: to the journal with its message id (systemd/calibd.catalog explains each) when the journal reads
/// our standard error, else as a line on standard error. Control characters are escaped. Priorities are syslog's.
void journal(int priority, std::string_view message_id, std::string_view text);

}  // namespace calib
