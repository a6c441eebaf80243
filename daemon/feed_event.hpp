#pragma once

#include <cstdint>
#include <nlohmann/json.hpp>
#include <string>
#include <string_view>

#include "calib/record.hpp"
#include "calib/store.hpp"
#include "drift_alert.hpp"

namespace calib {

/// One thing that the fleet is told, before it has its place in the feed. The text of the format is proto/feed.md.
struct FeedEvent {
  std::string type;
  std::string pair;  // empty: of the whole vehicle
  WallTime time{};   // when it happened
  nlohmann::json data;
};

/// What the types of verdicts end with: `suspected`, `confirmed`, `cleared` and `unavailable`.
[[nodiscard]] std::string_view told_word(Verdict verdict);

/// `record`: that of the extrinsic in force; none where it cannot be read.
[[nodiscard]] FeedEvent verdict_event(const DriftAlert& alert, const std::optional<SignedRecord>& record,
                                      std::uint64_t changes_held);
[[nodiscard]] FeedEvent record_event(const CalibrationRecord& record, const SignedRecord& bytes);
/// Of all pairs. What does not fit is left out: estimates first, then pairs from the end.
[[nodiscard]] FeedEvent state_event(const Status& status, WallTime now);

/// Where an event stands in the feed of a vehicle. `previous`: the sequence of the event before that was no state.
struct FeedPlace {
  std::string_view vehicle;
  std::uint64_t sequence = 0, previous = 0;
  WallTime expires{};
};
/// The event as it is sent: CloudEvents JSON in canonical form, signed, of at most `Store::max_event_bytes`. A reason
/// that is too long for that is cut.
[[nodiscard]] std::string event_text(FeedEvent event, const FeedPlace& place, const SigningKey& key);

}  // namespace calib
