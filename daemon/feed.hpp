#pragma once

#include <chrono>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <string_view>

#include "feed_event.hpp"
#include "feed_settings.hpp"

namespace calib {

/// What the fleet is told: decides which events there are, and writes them into the outbox of the store. A value: who
/// writes in a transaction works on a copy, and keeps that once the transaction is committed.
class Feed {
 public:
  /// What events are written with.
  struct Writer {
    Store& store;
    const SigningKey& key;
    std::string_view vehicle;
    WallTime now;
  };

  explicit Feed(FeedSettings settings) : settings_(settings) {}

  // All of these write in a transaction of the caller's.

  /// Reads what was told. Alerts that an earlier version left in the outbox become events.
  [[nodiscard]] Result<void> restore(const Writer& writer);
  [[nodiscard]] Result<void> tell(const Writer& writer, const CalibrationRecord& record, const SignedRecord& bytes);
  /// At once, not at all when it was told before, or later by `tell_held`.
  [[nodiscard]] Result<void> tell(const Writer& writer, const DriftAlert& alert);
  [[nodiscard]] Result<void> tell_held(const Writer& writer);
  /// That the pair has no verdict. To be called when that has lasted; is told once.
  [[nodiscard]] Result<void> tell_unavailable(const Writer& writer, const DriftAlert& alert);
  /// That something is wrong with the store or the key. The same is told once, until nothing is wrong (empty text).
  [[nodiscard]] Result<void> tell_trouble(const Writer& writer, const std::string& trouble);
  /// In the place of the one before, if that still waits.
  [[nodiscard]] Result<void> tell_state(const Writer& writer, const Status& status);

  // Whether the call above would do something.
  [[nodiscard]] bool held_is_due(WallTime now) const;
  [[nodiscard]] bool unavailable_is_due(std::string_view pair, std::chrono::nanoseconds without_verdict) const;
  [[nodiscard]] bool is_news(const std::string& trouble) const { return trouble != memory_.trouble; }
  /// Whether nothing was told of the pair, as far as is known.
  [[nodiscard]] bool is_untold(std::string_view pair) const {
    const auto told = memory_.pairs.find(pair);
    return told == memory_.pairs.end() || told->second.word.empty();
  }
  /// Once a day.
  [[nodiscard]] bool state_is_due(WallTime now) const;

  /// So many make room when the outbox is full: one gap is told instead of one with each event.
  static constexpr std::size_t dropped_at_once = 240;

 private:
  /// Of a pair's verdict.
  struct Told {
    std::string word;          // as of `told_word`; empty: nothing yet
    std::uint64_t record = 0;  // the extrinsic's
    WallTime at{};             // when it was written
    std::optional<DriftAlert> held = {};
    std::uint64_t changes_held = 0;
  };
  /// Saved with every event, and authenticated: who could edit it could hide the loss of an event.
  struct Memory {
    std::uint64_t last = 0;  // sequence of the last event that was no state
    std::optional<WallTime> state;
    std::string trouble;
    std::map<std::string, Told, std::less<>> pairs;
  };

  [[nodiscard]] static std::string to_text(const Memory& memory);
  [[nodiscard]] static std::optional<Memory> parse(std::string_view text);
  [[nodiscard]] Result<void> adopt_alerts(const Writer& writer);
  [[nodiscard]] Result<void> tell_now(const Writer& writer, const DriftAlert& alert);
  [[nodiscard]] Result<void> write(const Writer& writer, FeedEvent event, Store::Priority priority);
  [[nodiscard]] Result<void> append(const Writer& writer, FeedEvent event, Store::Priority priority);
  [[nodiscard]] Result<void> make_room(const Writer& writer);
  [[nodiscard]] Result<void> save(const Writer& writer) const;
  [[nodiscard]] bool debounce_is_over(const Told& told, WallTime now) const;

  FeedSettings settings_;
  Memory memory_;
};

}  // namespace calib
