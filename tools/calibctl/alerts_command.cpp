#include <iostream>
#include <thread>

#include "calib/json_integer.hpp"
#include "commands.hpp"
#include "control_client.hpp"
#include "table.hpp"
#include "text.hpp"

namespace calib::ctl {
namespace {

using nlohmann::json;

/// calibd holds a reply without events for 30 s, and an acknowledgement for as long as a step of it takes.
constexpr std::chrono::seconds longest_reply{60}, longest_acknowledgement{600};
constexpr std::chrono::seconds between_attempts{1};

struct Event {
  std::uint64_t sequence = 0;
  std::string text;
};

struct Page {
  std::string run;
  std::vector<Event> events;
};

Result<Page> ask_page(const Paths& paths, std::uint64_t after, bool wait) {
  const auto reply = ask(paths.socket, {{"schema", 1}, {"request", "feed"}, {"after", after}, {"wait", wait}},
                         longest_reply, [](auto) {});
  if (!reply) return propagate(reply);
  try {
    Page page{.run = reply->at("run").get<std::string>(), .events = {}};
    for (const json& event : reply->at("events"))
      page.events.push_back({integer_from<std::uint64_t>(event.at("sequence")), event.at("event").get<std::string>()});
    return page;
  } catch (const std::exception& error) {
    return fail(ErrorCode::malformed_reply,
                std::string("calibd answered in a form that is not understood: ") + error.what());
  }
}

/// `confirmed` of `calibd.drift.confirmed.v1`.
std::string word_of(const std::string& type) {
  const auto end = type.rfind('.');
  const auto begin = end == std::string::npos || end == 0 ? std::string::npos : type.rfind('.', end - 1);
  return begin == std::string::npos ? type : type.substr(begin + 1, end - begin - 1);
}

std::string detail_of(const json& data) {
  if (data.contains("reason")) return data.at("reason").get<std::string>();
  if (data.contains("from"))
    return "events " + data.at("from").dump() + " to " + data.at("to").dump() + " were lost: the outbox was full";
  std::string verdicts;
  for (const json& pair : data.value("pairs", json::array()))
    verdicts += (verdicts.empty() ? "" : ", ") + pair.at("name").get<std::string>() + " " +
                pair.at("verdict").get<std::string>();
  return verdicts;
}

Colour colour_of(const std::string& word) {
  if (word == "confirmed" || word == "trouble" || word == "gap") return Colour::red;
  if (word == "suspected" || word == "unavailable" || word == "rejected") return Colour::yellow;
  return word == "cleared" || word == "recalibrated" ? Colour::green : Colour::none;
}

void event_row(Table& table, const Event& event) {
  constexpr std::size_t widest_pair = 24;
  const json all = parse_json(event.text);
  try {
    const std::string word = word_of(all.at("type").get<std::string>());
    std::string time = all.at("time").get<std::string>().substr(0, 19);
    if (const auto t = time.find('T'); t != std::string::npos) time[t] = ' ';
    table.row({{std::to_string(event.sequence)},
               {time},
               {cut(all.value("subject", "-"), widest_pair)},
               {word, colour_of(word)}});
    table.detail(detail_of(all.at("data")));
  } catch (const std::exception&) {
    table.row({{std::to_string(event.sequence)}, {"-"}, {"-"}, {"unreadable", Colour::red}});
  }
}

void print(const Page& page, bool as_json) {
  if (page.events.empty()) return;
  Table table({"SEQ", "TIME (UTC)", "PAIR", "EVENT"}, terminal_has_colours());
  for (const Event& event : page.events)
    if (as_json)
      std::cout << json_text(parse_json(event.text), -1);
    else
      event_row(table, event);
  if (!as_json) std::cout << table.str();
  std::cout << std::flush;
}

/// Not before they have been printed.
Result<void> acknowledge(const Paths& paths, const Page& page) {
  if (!std::cout) return fail(ErrorCode::failed, "the events could not be printed, and stay in the outbox");
  const auto reply =
      ask(paths.socket,
          {{"schema", 1}, {"request", "acknowledge"}, {"through", page.events.back().sequence}, {"run", page.run}},
          longest_acknowledgement, show_waiting);
  clear_waiting();
  if (!reply) return propagate(reply);
  return {};
}

bool may_pass(const Error& error) {
  return error.code == ErrorCode::daemon_not_running || error.code == ErrorCode::no_answer;
}

}  // namespace

Exit alerts(const Paths& paths, const AlertsOptions& options) {
  std::uint64_t after = 0;
  for (bool caught_up = false, any = false;;) {
    const auto page = ask_page(paths, after, options.follow && caught_up);
    if (!page && options.follow && any && may_pass(page.error())) {
      std::this_thread::sleep_for(between_attempts);  // it is started again
      continue;
    }
    if (!page) return print_error(page.error());
    any = true;
    caught_up = page->events.empty();
    if (caught_up && !options.follow) return Exit::done;
    if (caught_up) continue;
    print(*page, options.json);
    after = page->events.back().sequence;
    if (!options.acknowledge) continue;
    if (const auto done = acknowledge(paths, *page); !done) return print_error(done.error());
  }
}

}  // namespace calib::ctl
