#include "journal_reader.hpp"

#include <systemd/sd-journal.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <cstdint>
#include <cstring>
#include <memory>

namespace calib::ctl {
namespace {

struct Close {
  void operator()(sd_journal* journal) const { ::sd_journal_close(journal); }
};
using Journal = std::unique_ptr<sd_journal, Close>;

/// libsystemd opens no file that this user may not read, and says nothing about it.
Result<void> may_read_system_journal() {
  bool exists = false;
  for (const char* const folder : {"/var/log/journal", "/run/log/journal"}) {
    std::error_code error;
    for (const auto& machine : std::filesystem::directory_iterator(folder, error)) {
      const auto file = machine.path() / "system.journal";
      if (::access(file.c_str(), R_OK) == 0) return {};
      exists = exists || errno == EACCES;
    }
    exists = exists || error == std::errc::permission_denied;
  }
  if (!exists) return fail(ErrorCode::not_found, "there is no journal");
  return fail(ErrorCode::denied, "only root and members of the group systemd-journal may read the journal");
}

Result<Journal> open(const std::filesystem::path& folder) {
  sd_journal* opened = nullptr;
  if (folder.empty())
    if (const auto readable = may_read_system_journal(); !readable) return propagate(readable);
  const int made = folder.empty() ? ::sd_journal_open(&opened, SD_JOURNAL_LOCAL_ONLY | SD_JOURNAL_SYSTEM)
                                  : ::sd_journal_open_directory(&opened, folder.c_str(), 0);
  Journal journal(opened);
  if (made < 0)
    return fail(made == -ENOENT ? ErrorCode::not_found : ErrorCode::failed,
                std::string("the journal cannot be opened: ") + std::strerror(-made));
  return journal;
}

/// Of the present entry; empty when it has no such field.
std::string field(sd_journal* journal, const char* name) {
  const void* data = nullptr;
  std::size_t size = 0;
  if (::sd_journal_get_data(journal, name, &data, &size) < 0) return {};
  const std::string_view text(static_cast<const char*>(data), size);
  return std::string(text.substr(text.find('=') + 1));
}

template <typename Number>
std::optional<Number> number(const std::string& text) {
  Number value{};
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc() || end != text.data() + text.size()) return std::nullopt;
  return value;
}

}  // namespace

Result<void> read_journal(const std::filesystem::path& folder, std::optional<WallTime> since,
                          const std::function<void(JournalEvent)>& take) {
  const auto journal = open(folder);
  if (!journal) return propagate(journal);
  sd_journal* const entries = journal->get();
  const auto microseconds = [](WallTime time) {
    const std::int64_t since_1970 = std::chrono::floor<std::chrono::microseconds>(time).count();
    return static_cast<std::uint64_t>(std::max<std::int64_t>(0, since_1970));
  };
  const bool ready =
      ::sd_journal_add_match(entries, "_SYSTEMD_UNIT=calibd.service", 0) >= 0 &&
      ::sd_journal_add_match(entries, "SYSLOG_IDENTIFIER=calibd", 0) >= 0 &&
      (since ? ::sd_journal_seek_realtime_usec(entries, microseconds(*since)) : ::sd_journal_seek_head(entries)) >= 0;
  if (!ready) return fail(ErrorCode::failed, "the journal cannot be searched");
  int next = 0;
  while ((next = ::sd_journal_next(entries)) > 0) {
    std::uint64_t time_us = 0;
    // Lines of libraries have no message id.
    if (::sd_journal_get_realtime_usec(entries, &time_us) < 0 || field(entries, "MESSAGE_ID").empty()) continue;
    JournalEvent event;
    event.time = std::chrono::microseconds(time_us);
    event.priority = number<int>(field(entries, "PRIORITY")).value_or(6);
    event.message = field(entries, "MESSAGE");
    event.pair = field(entries, "PAIR");
    event.verdict = field(entries, "VERDICT");
    event.reason = field(entries, "REASON");
    event.cause = field(entries, "CAUSE");
    event.record = number<std::uint64_t>(field(entries, "RECORD"));
    take(std::move(event));
  }
  if (next < 0)
    return fail(ErrorCode::failed, std::string("the journal cannot be read to its end: ") + std::strerror(-next));
  return {};
}

}  // namespace calib::ctl
