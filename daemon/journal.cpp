#include "journal.hpp"

#include <spdlog/spdlog.h>
#define SD_JOURNAL_SUPPRESS_LOCATION
#include <systemd/sd-journal.h>

#include <cstdlib>
#include <string>

#include "calib/result.hpp"

namespace calib {

void journal(int priority, std::string_view message_id, std::string_view text) {
  const std::string line = escape_control(text);
  static const bool to_journal = std::getenv("JOURNAL_STREAM") != nullptr;
  if (to_journal &&
      sd_journal_send("PRIORITY=%d", priority, "MESSAGE_ID=%.*s", static_cast<int>(message_id.size()),
                      message_id.data(), "MESSAGE=%s", line.c_str(), "SYSLOG_IDENTIFIER=calibd", nullptr) == 0)
    return;
  spdlog::log(priority <= 3   ? spdlog::level::err
              : priority == 4 ? spdlog::level::warn
                              : spdlog::level::info,
              "{}", line);
}

}  // namespace calib
