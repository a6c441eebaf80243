#include <algorithm>
#include <iostream>
#include <nlohmann/json.hpp>

#include "calib/json_integer.hpp"
#include "commands.hpp"
#include "journal_reader.hpp"
#include "status_report.hpp"
#include "stored_records.hpp"
#include "table.hpp"
#include "text.hpp"

namespace calib::ctl {
namespace {

using nlohmann::json;

/// What happened, as one of the sources has it.
struct Event {
  WallTime time{};
  std::string pair;   // empty: of no pair
  std::string event;  // a decision, a verdict, or error, warning, notice
  std::string text;
  std::string source;  // record, alert or journal
  std::optional<std::uint64_t> number;
  bool verified = false;  // signed, and the signature and its place in the chain are right
};

struct Source {
  std::string name;
  std::optional<Error> unreadable;  // nothing of it is among the events, or not all
  std::size_t events = 0;
};

struct Found {
  std::vector<Event> events;
  std::vector<Source> sources;
  bool chain_is_broken = false;
};

void add_records(const Paths& paths, Found& found) {
  Source source{.name = "records", .unreadable = {}};
  if (const auto chain = read_chain(paths)) {
    for (const auto& [record, bytes] : chain->verified)
      found.events.push_back({record.wall_time, record.pair, std::string(to_string(record.decision)), record.reason,
                              "record", record.sequence, true});
    source.events = chain->verified.size();
    source.unreadable = chain->broken;
    found.chain_is_broken = chain->broken.has_value();
  } else {
    source.unreadable = chain.error();
  }
  found.sources.push_back(std::move(source));
}

Result<Event> event_of_alert(const std::string& text) {
  try {
    const json alert = parse_json(text);
    const auto time = parse_rfc3339(alert.at("stamp").get<std::string>());
    if (!time) return propagate(time);
    return Event{*time,
                 alert.at("pair").get<std::string>(),
                 alert.at("verdict").get<std::string>(),
                 alert.at("reason").get<std::string>(),
                 "alert",
                 integer_from<std::uint64_t>(alert.at("alert_sequence"))};
  } catch (const std::exception& error) {
    return fail(ErrorCode::malformed_alert, std::string("an alert cannot be read: ") + error.what());
  }
}

void add_alerts(const Paths& paths, Found& found) {
  constexpr std::size_t most = 100'000;
  Source source{.name = "alerts", .unreadable = {}};
  const auto read = [&]() -> Result<std::vector<Store::Alert>> {
    if (only_daemon_may_read(paths))
      return fail(ErrorCode::denied, "only calibd and root may read " + paths.store().string());
    const auto store = Store::open(paths.store(), Store::Mode::read_only);
    if (!store) return propagate(store);
    return store->latest_alerts(most);
  };
  if (const auto alerts = read()) {
    for (const Store::Alert& alert : *alerts) {
      auto event = event_of_alert(alert.json);
      if (!event) {
        source.unreadable = event.error();
        continue;
      }
      found.events.push_back(std::move(*event));
      ++source.events;
    }
  } else {
    source.unreadable = alerts.error();
  }
  found.sources.push_back(std::move(source));
}

/// Whether an event that is known from elsewhere is what this one tells.
bool is_told(const Found& found, const JournalEvent& event) {
  constexpr std::chrono::seconds apart{5};
  return std::ranges::any_of(found.events, [&](const Event& known) {
    return known.source != "journal" && known.pair == event.pair && std::chrono::abs(known.time - event.time) < apart &&
           event.message.find(escape_control(known.text)) != std::string::npos;
  });
}

void add_journal(const std::filesystem::path& folder, std::optional<WallTime> since, Found& found) {
  Source source{.name = "journal", .unreadable = {}};
  const auto read = read_journal(folder, since, [&](const JournalEvent& event) {
    ++source.events;
    if (is_told(found, event)) return;
    found.events.push_back({event.time, event.pair,
                            event.priority <= 3   ? "error"
                            : event.priority == 4 ? "warning"
                                                  : "notice",
                            event.message, "journal", event.record});
  });
  if (!read) source.unreadable = read.error();
  found.sources.push_back(std::move(source));
}

std::string events_table(const std::vector<Event>& events) {
  constexpr std::size_t widest_pair = 24;
  Table table({"TIME (UTC)", "PAIR", "EVENT", "SOURCE"}, /*coloured=*/false);
  for (const Event& event : events) {
    std::string time = rfc3339(event.time).substr(0, 19);
    time[10] = ' ';
    table.row({{time},
               {event.pair.empty() ? "-" : cut(event.pair, widest_pair)},
               {event.event},
               {event.source + (event.number && event.source != "journal" ? " " + std::to_string(*event.number) : "") +
                (event.verified ? ", verified" : "")}});
    table.detail(event.text);
  }
  return table.str();
}

json events_json(const Found& found) {
  json events = json::array(), sources = json::array();
  for (const Event& event : found.events) {
    json each{{"time", rfc3339(event.time)},
              {"event", event.event},
              {"text", event.text},
              {"source", event.source},
              {"verified", event.verified}};
    if (!event.pair.empty()) each["pair"] = event.pair;
    if (event.number) each[event.source == "alert" ? "alert" : "record"] = *event.number;
    events.push_back(std::move(each));
  }
  for (const Source& source : found.sources) {
    json each{{"source", source.name}, {"complete", !source.unreadable}, {"events", source.events}};
    if (source.unreadable) each["why"] = source.unreadable->context;
    sources.push_back(std::move(each));
  }
  return {{"schema", 1}, {"events", std::move(events)}, {"sources", std::move(sources)}};
}

}  // namespace

std::optional<WallTime> parse_since(std::string_view text) {
  if (auto time = parse_rfc3339(text)) return *time;
  if (auto day = parse_rfc3339(std::string(text) + "T00:00:00Z")) return *day;
  std::string ago(text);
  int times = 1;
  if (ago.ends_with('d')) ago.back() = 'h', times = 24;
  const auto duration = parse_duration(ago);
  if (!duration || text.find_first_not_of("0123456789.") == std::string_view::npos) return std::nullopt;
  return wall_clock() - times * *duration;
}

Exit events(const Paths& paths, const EventsOptions& options) {
  Found found;
  add_records(paths, found);
  add_alerts(paths, found);
  add_journal(options.journal, options.since, found);
  std::erase_if(found.events, [&](const Event& event) {
    return (options.since && event.time < *options.since) || (!options.pair.empty() && event.pair != options.pair);
  });
  std::ranges::stable_sort(found.events, {}, &Event::time);
  if (options.json)
    std::cout << json_text(events_json(found), 2);
  else if (!found.events.empty())
    std::cout << events_table(found.events);
  std::cout << std::flush;
  for (const Source& source : found.sources)
    if (source.unreadable)
      std::cerr << "calibctl: " << source.name << (source.events > 0 ? " not complete: " : " not read: ")
                << escape_control(source.unreadable->context) << '\n';
  if (found.chain_is_broken) return Exit::no;
  return std::ranges::all_of(found.sources,
                             [](const Source& source) { return source.unreadable && source.events == 0; })
             ? Exit::not_found
             : Exit::done;
}

}  // namespace calib::ctl
