#include "feed.hpp"

#include <algorithm>

#include "calib/json_integer.hpp"

namespace calib {
namespace {

using namespace std::chrono_literals;
using nlohmann::json;

constexpr std::string_view memory_purpose = "calibd feed";
/// After which events are no longer of use to a consumer. None is removed for that on the vehicle, whose clock may
/// jump.
constexpr std::chrono::hours alert_lifetime = 90 * 24h, state_lifetime = 3 * 24h, state_period = 24h;

/// Whether so much time has passed; also when the clock was set back behind `since`.
bool has_passed(WallTime since, std::chrono::nanoseconds time, WallTime now) {
  return now < since || now - since >= time;
}

FeedEvent gap_event(std::uint64_t from, std::uint64_t to, WallTime now) {
  return {.type = "calibd.feed.gap.v1", .pair = "", .time = now, .data = {{"from", from}, {"to", to}}};
}

/// The first event that a gap in the outbox tells of.
std::uint64_t begin_of_gap(const Store::Event& gap) {
  try {
    return integer_from<std::uint64_t>(json::parse(gap.json).at("data").at("from"));
  } catch (const std::exception&) {
    return gap.sequence;
  }
}

FeedEvent trouble_event(const std::string& trouble, WallTime now) {
  return {.type = "calibd.store.trouble.v1", .pair = "", .time = now, .data = {{"reason", trouble}}};
}

/// The record of the extrinsic in force; none where an event has to do without.
std::optional<SignedRecord> record_of(const Store& store, std::uint64_t sequence) {
  auto record = store.record(sequence);
  return record ? std::optional(std::move(*record)) : std::nullopt;
}

}  // namespace

std::string Feed::to_text(const Memory& memory) {
  json pairs = json::object();
  for (const auto& [name, told] : memory.pairs) {
    json& pair = pairs[name] = {{"word", told.word}, {"record", told.record}, {"at", rfc3339_ns(told.at)}};
    if (told.held) pair["held"] = alert_text(*told.held);
    if (told.changes_held > 0) pair["changes_held"] = told.changes_held;
  }
  return json{{"last", memory.last},
              {"state", memory.state ? json(rfc3339_ns(*memory.state)) : json()},
              {"trouble", memory.trouble},
              {"pairs", std::move(pairs)}}
      .dump(-1, ' ', false, json::error_handler_t::replace);
}

std::optional<Feed::Memory> Feed::parse(std::string_view text) {
  try {
    const json in = json::parse(text);
    Memory memory{.last = integer_from<std::uint64_t>(in.at("last")),
                  .state = {},
                  .trouble = in.at("trouble").get<std::string>(),
                  .pairs = {}};
    if (!in.at("state").is_null()) memory.state = parse_rfc3339(in.at("state").get<std::string>()).value();
    for (const auto& [name, pair] : in.at("pairs").items()) {
      Told& told = memory.pairs[name];
      told.word = pair.at("word").get<std::string>();
      told.record = integer_from<std::uint64_t>(pair.at("record"));
      told.at = parse_rfc3339(pair.at("at").get<std::string>()).value();
      if (pair.contains("held")) told.held = parse_alert(pair.at("held").get<std::string>()).value();
      if (pair.contains("changes_held")) told.changes_held = integer_from<std::uint64_t>(pair.at("changes_held"));
    }
    return memory;
  } catch (const std::exception&) {
    return std::nullopt;
  }
}

Result<void> Feed::save(const Writer& writer) const {
  const std::string text = to_text(memory_);
  return writer.store.save_feed_memory(writer.key.mac(memory_purpose, text) + '\n' + text);
}

Result<void> Feed::restore(const Writer& writer) {
  const auto saved = writer.store.feed_memory();
  if (!saved) return propagate(saved);
  if (!*saved) return adopt_alerts(writer);
  const std::string_view all = **saved;
  const auto end = std::min(all.find('\n'), all.size());
  const std::string_view text = all.substr(std::min(end + 1, all.size()));
  if (writer.key.is_mac(memory_purpose, text, all.substr(0, end)))
    if (auto memory = parse(text)) {
      memory_ = std::move(*memory);
      return {};
    }
  return tell_trouble(writer, "what was told before is not known: it was not written by calibd with this signing key");
}

/// Signs in place what an earlier version left in the outbox, if anything.
Result<void> Feed::adopt_alerts(const Writer& writer) {
  const auto rows = writer.store.waiting_events(0, Store::max_waiting_events);
  if (!rows) return propagate(rows);
  const auto next = writer.store.next_event_sequence();
  if (!next) return propagate(next);
  if (*next == 1) return {};
  const auto is_earlier = [](const Store::Event& row) { return row.priority == Store::Priority::unsent_alert; };
  if (rows->empty() || !std::ranges::all_of(*rows, is_earlier))
    return tell_trouble(writer, "what was told before is missing from the store");
  memory_.last = rows->front().sequence - 1;
  for (const Store::Event& row : *rows) {
    const auto alert = parse_alert(row.json);
    const FeedPlace place{writer.vehicle, row.sequence, memory_.last, writer.now + alert_lifetime};
    // Nobody has signed that text: it may warn, and clears nothing.
    const bool warns = alert && alert->verdict != Verdict::calibrated;
    FeedEvent event = warns ? verdict_event(*alert, record_of(writer.store, alert->record_sequence), 0)
                            : trouble_event(alert ? "an alert of an earlier calibd, not signed: " + alert->reason
                                                  : alert.error().context,
                                            writer.now);
    if (warns)
      memory_.pairs[alert->pair] = {std::string(told_word(alert->verdict)), alert->record_sequence, writer.now};
    if (auto replaced = writer.store.replace_event(
            {row.sequence, Store::Priority::alert, place.expires, event_text(std::move(event), place, writer.key)});
        !replaced)
      return replaced;
    memory_.last = row.sequence;
  }
  const std::uint64_t first = rows->front().sequence;
  return first == 1 ? save(writer) : write(writer, gap_event(1, first - 1, writer.now), Store::Priority::gap);
}

Result<void> Feed::tell(const Writer& writer, const CalibrationRecord& record, const SignedRecord& bytes) {
  return write(writer, record_event(record, bytes), Store::Priority::alert);
}

Result<void> Feed::tell(const Writer& writer, const DriftAlert& alert) {
  if (alert.verdict == Verdict::not_evaluated) return {};  // that is normal, and says nothing against what was told
  Told& told = memory_.pairs[alert.pair];
  const std::string_view word = told_word(alert.verdict);
  const bool is_known =
      word == told.word && (alert.record_sequence == told.record || alert.verdict == Verdict::calibrated);
  if (is_known || (alert.verdict == Verdict::calibrated && told.word.empty())) {
    if (!std::exchange(told.held, std::nullopt)) return {};
    ++told.changes_held;
    return save(writer);
  }
  if (alert.verdict == Verdict::drifted || debounce_is_over(told, writer.now)) return tell_now(writer, alert);
  told.held = alert;
  ++told.changes_held;
  return save(writer);
}

Result<void> Feed::tell_now(const Writer& writer, const DriftAlert& alert) {
  Told& told = memory_.pairs[alert.pair];
  // What was held last is told now; or it was followed by what is told now.
  const std::uint64_t changes_held =
      told.changes_held - (told.held && told.held->alert_sequence == alert.alert_sequence);
  told = {std::string(told_word(alert.verdict)), alert.record_sequence, writer.now};
  return write(writer, verdict_event(alert, record_of(writer.store, alert.record_sequence), changes_held),
               Store::Priority::alert);
}

bool Feed::debounce_is_over(const Told& told, WallTime now) const {
  return told.word.empty() || has_passed(told.at, settings_.debounce, now);
}

bool Feed::held_is_due(WallTime now) const {
  return std::ranges::any_of(memory_.pairs,
                             [&](const auto& pair) { return pair.second.held && debounce_is_over(pair.second, now); });
}

Result<void> Feed::tell_held(const Writer& writer) {
  std::vector<DriftAlert> due;
  for (const auto& [name, told] : memory_.pairs)
    if (told.held && debounce_is_over(told, writer.now)) due.push_back(*told.held);
  for (const DriftAlert& alert : due)
    if (auto told = tell_now(writer, alert); !told) return told;
  return {};
}

bool Feed::unavailable_is_due(std::string_view pair, std::chrono::nanoseconds without_verdict) const {
  const auto told = memory_.pairs.find(pair);
  return without_verdict >= settings_.unavailable_after &&
         (told == memory_.pairs.end() || told->second.word != told_word(Verdict::not_evaluated));
}

Result<void> Feed::tell_unavailable(const Writer& writer, const DriftAlert& alert) {
  if (const std::optional<DriftAlert> held = memory_.pairs[alert.pair].held)
    if (auto told = tell_now(writer, *held); !told) return told;
  return tell_now(writer, alert);
}

Result<void> Feed::tell_trouble(const Writer& writer, const std::string& trouble) {
  memory_.trouble = trouble;
  return trouble.empty() ? save(writer) : write(writer, trouble_event(trouble, writer.now), Store::Priority::alert);
}

bool Feed::state_is_due(WallTime now) const { return !memory_.state || has_passed(*memory_.state, state_period, now); }

Result<void> Feed::tell_state(const Writer& writer, const Status& status) {
  memory_.state = writer.now;
  if (auto forgotten = writer.store.forget_states(); !forgotten) return forgotten;
  return write(writer, state_event(status, writer.now), Store::Priority::state);
}

Result<void> Feed::write(const Writer& writer, FeedEvent event, Store::Priority priority) {
  if (auto room = make_room(writer); !room) return room;
  if (auto appended = append(writer, std::move(event), priority); !appended) return appended;
  return save(writer);
}

Result<void> Feed::append(const Writer& writer, FeedEvent event, Store::Priority priority) {
  const auto sequence = writer.store.next_event_sequence();
  if (!sequence) return propagate(sequence);
  const bool is_state = priority == Store::Priority::state;
  const FeedPlace place{writer.vehicle, *sequence, memory_.last,
                        writer.now + (is_state ? state_lifetime : alert_lifetime)};
  if (!is_state) memory_.last = *sequence;
  return writer.store.enqueue_event(
      {*sequence, priority, place.expires, event_text(std::move(event), place, writer.key)});
}

/// The oldest go when the outbox is full. A gap that goes with them becomes a part of the new one.
Result<void> Feed::make_room(const Writer& writer) {
  const auto waiting = writer.store.waiting_event_count();
  if (!waiting) return propagate(waiting);
  if (*waiting + 2 <= Store::max_waiting_events) return {};  // for the event and, another time, the gap
  const auto oldest = writer.store.waiting_events(0, dropped_at_once);
  if (!oldest) return propagate(oldest);
  std::uint64_t from = oldest->front().sequence;
  for (const Store::Event& event : *oldest)
    if (event.priority == Store::Priority::gap) from = std::min(from, begin_of_gap(event));
  const std::uint64_t to = oldest->back().sequence;
  if (auto dropped = writer.store.acknowledge(to); !dropped) return dropped;
  return append(writer, gap_event(from, to, writer.now), Store::Priority::gap);
}

}  // namespace calib
