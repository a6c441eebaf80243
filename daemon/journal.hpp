#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

namespace calib {

/// What an event is about, for `journalctl PAIR=front VERDICT=drifted`: fields beside the message, left out where
/// empty.
struct JournalFields {
  std::string pair;
  std::string verdict;  // after the event
  std::optional<std::uint64_t> record;
  std::string reason;  // the sentence in the status
  std::string cause;   // its code: of a pair that is not evaluated, or of a failure
};

/// A message and its fields; most messages have none.
struct JournalText {
  std::string text;
  JournalFields fields{};
  JournalText(std::string message) : text(std::move(message)) {}  // NOLINT(google-explicit-constructor)
  JournalText(std::string message, JournalFields about) : text(std::move(message)), fields(std::move(about)) {}
};

/// One logged event: to the journal with its message id (systemd/calibd.catalog explains each) and its fields PAIR,
/// VERDICT, RECORD, REASON and CAUSE when the journal reads our standard error, else as a line on standard error.
/// Control characters are escaped. Priorities are syslog's.
void journal(int priority, std::string_view message_id, const JournalText& what);

}  // namespace calib
