#include "journal.hpp"

#include <spdlog/spdlog.h>
#define SD_JOURNAL_SUPPRESS_LOCATION
#include <sys/uio.h>
#include <systemd/sd-journal.h>

#include <cstdlib>
#include <vector>

#include "calib/result.hpp"

namespace calib {
namespace {

bool send_to_journal(int priority, std::string_view message_id, const std::string& line, const JournalFields& fields) {
  std::vector<std::string> lines{"PRIORITY=" + std::to_string(priority), "MESSAGE_ID=" + std::string(message_id),
                                 "MESSAGE=" + line, "SYSLOG_IDENTIFIER=calibd"};
  const auto add = [&](const char* name, const std::string& value) {
    if (!value.empty()) lines.push_back(name + escape_control(value));
  };
  add("PAIR=", fields.pair);
  add("VERDICT=", fields.verdict);
  add("RECORD=", fields.record ? std::to_string(*fields.record) : "");
  add("REASON=", fields.reason);
  add("CAUSE=", fields.cause);
  std::vector<iovec> parts;
  for (std::string& each : lines) parts.push_back({each.data(), each.size()});
  return sd_journal_sendv(parts.data(), static_cast<int>(parts.size())) == 0;
}

}  // namespace

void journal(int priority, std::string_view message_id, const JournalText& what) {
  const std::string line = escape_control(what.text);
  static const bool to_journal = std::getenv("JOURNAL_STREAM") != nullptr;
  if (to_journal && send_to_journal(priority, message_id, line, what.fields)) return;
  spdlog::log(priority <= 3   ? spdlog::level::err
              : priority == 4 ? spdlog::level::warn
                              : spdlog::level::info,
              "{}", line);
}

}  // namespace calib
