#include <algorithm>
#include <array>
#include <charconv>
#include <iostream>
#include <thread>

#include "commands.hpp"
#include "status_report.hpp"
#include "status_text.hpp"
#include "text.hpp"

namespace calib::ctl {
namespace {

using nlohmann::json;
using Clock = std::chrono::steady_clock;

constexpr std::chrono::milliseconds between_questions{500};
/// Longer than a running calibd ever needs.
constexpr std::chrono::seconds longest_answer{5};

/// What a change is noticed by.
struct Seen {
  std::string name;
  Verdict verdict = Verdict::not_evaluated;
  WallTime since{};
  friend bool operator==(const Seen&, const Seen&) = default;
};

std::vector<Seen> seen_in(const Report& report) {
  std::vector<Seen> all;
  for (const PairStatus& pair : report.status.pairs) all.push_back({pair.name, pair.verdict, pair.since});
  return all;
}

/// `front is suspect, rear is not evaluated`.
std::string verdicts_of(const Report& report) {
  std::string words;
  for (const PairStatus& pair : report.status.pairs)
    words += (words.empty() ? "" : ", ") + pair.name + " is " + words_of(pair.verdict);
  return words.empty() ? "there is no pair" : words;
}

/// Of all pairs for `calibrated`, of at least one for the others.
bool is_reached(WaitFor what, Report& report, const std::vector<Seen>& first, const Paths& paths) {
  const auto& pairs = report.status.pairs;
  const auto any = [&](Verdict verdict) {
    return std::ranges::find(pairs, verdict, &PairStatus::verdict) != pairs.end();
  };
  switch (what) {
    case WaitFor::calibrated:
      if (pairs.empty() || report.status.signing_refused ||
          !std::ranges::all_of(pairs, [](const auto& pair) { return pair.verdict == Verdict::calibrated; }))
        return false;
      check(report, paths);
      return records_verify(report);
    case WaitFor::drifted:
      return any(Verdict::drifted);
    case WaitFor::not_evaluated:
      return any(Verdict::not_evaluated);
    case WaitFor::any_change:
      return seen_in(report) != first;
  }
  return false;
}

/// Not running and not answering may pass; everything else is the same at the next question.
bool may_pass(const Error& error) {
  return error.code == ErrorCode::daemon_not_running || error.code == ErrorCode::no_answer;
}

json result_json(bool reached, const WaitOptions& options, double waited_s, const std::optional<Report>& last) {
  json pairs = json::array();
  if (last)
    for (const PairStatus& pair : last->status.pairs)
      pairs.push_back({{"name", pair.name}, {"verdict", to_string(pair.verdict)}, {"since", rfc3339(pair.since)}});
  return {{"schema", 1},
          {"for", to_string(options.what)},
          {"reached", reached},
          {"waited_s", waited_s},
          {"pairs", std::move(pairs)}};
}

}  // namespace

std::string_view to_string(WaitFor what) {
  switch (what) {
    case WaitFor::calibrated:
      return "calibrated";
    case WaitFor::drifted:
      return "drifted";
    case WaitFor::not_evaluated:
      return "not_evaluated";
    case WaitFor::any_change:
      return "any-change";
  }
  return "";
}

std::optional<std::chrono::milliseconds> parse_duration(std::string_view text) {
  double number = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), number);
  text.remove_prefix(static_cast<std::size_t>(end - text.data()));
  constexpr std::array<std::pair<std::string_view, double>, 5> units{
      {{"", 1}, {"ms", 1e-3}, {"s", 1}, {"min", 60}, {"h", 3600}}};
  const auto unit = std::ranges::find(units, text, &std::pair<std::string_view, double>::first);
  constexpr double longest_s = 365.0 * 86400;
  if (error != std::errc() || unit == units.end() || !(number >= 0 && number * unit->second <= longest_s))
    return std::nullopt;
  return std::chrono::round<std::chrono::milliseconds>(std::chrono::duration<double>(number * unit->second));
}

Exit wait(const Paths& paths, const WaitOptions& options) {
  const auto start = Clock::now();
  const auto end = start + options.timeout;
  std::optional<Report> last;
  std::optional<std::vector<Seen>> first;
  std::string trouble;
  for (;;) {
    const auto left = std::chrono::ceil<std::chrono::seconds>(end - Clock::now());
    auto report = ask_status(paths, std::clamp(left, std::chrono::seconds(1), longest_answer));
    if (report && !options.pair.empty())
      if (const auto kept = keep_pair(*report, options.pair); !kept) return print_error(kept.error());
    if (!report && !may_pass(report.error())) return print_error(report.error());
    bool reached = false;
    if (report) {
      if (!first) first = seen_in(*report);
      reached = is_reached(options.what, *report, *first, paths);
      trouble = verdicts_of(*report);
      if (report->status.signing_refused) trouble += ", but signing is refused: " + *report->status.signing_refused;
      if (!records_verify(*report)) trouble += ", but its record does not verify";
      last = std::move(*report);
    } else {
      trouble = report.error().context;
      last.reset();
    }
    const double waited_s = std::chrono::duration<double>(Clock::now() - start).count();
    if (reached || Clock::now() >= end) {
      if (options.json)
        std::cout << json_text(result_json(reached, options, waited_s, last), 2);
      else if (reached)
        std::cout << escape_control(trouble) << ", after " << decimals(waited_s, 1) << " s\n";
      if (reached) return Exit::done;
      std::cout << std::flush;
      std::cerr << "calibctl: not reached within " << decimals(waited_s, 1) << " s: " << escape_control(trouble)
                << '\n';
      return Exit::timed_out;
    }
    std::this_thread::sleep_until(std::min(end, Clock::now() + between_questions));
  }
}

}  // namespace calib::ctl
