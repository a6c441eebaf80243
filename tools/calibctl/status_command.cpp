#include <unistd.h>

#include <algorithm>
#include <csignal>
#include <iostream>

#include "commands.hpp"
#include "screen.hpp"
#include "status_report.hpp"
#include "status_text.hpp"
#include "text.hpp"

namespace calib::ctl {
namespace {

constexpr std::chrono::seconds status_timeout{10};
/// A watcher who wants to end does not wait for a daemon that hangs.
constexpr std::chrono::seconds watch_timeout{2};

Result<Report> collect(const Paths& paths, const StatusOptions& options, std::chrono::seconds timeout) {
  auto report = ask_status_or_snapshot(paths, timeout);
  if (!report) return report;
  if (!options.pair.empty())
    if (const auto kept = keep_pair(*report, options.pair); !kept) return propagate(kept);
  check(*report, paths);
  return report;
}

Exit exit_of(const Report& report, bool by_verdict) {
  if (!records_verify(report)) return Exit::no;
  if (!report.status.running) return Exit::not_found;
  const bool calibrated =
      std::ranges::all_of(report.status.pairs, [](const auto& pair) { return pair.verdict == Verdict::calibrated; });
  const bool well = calibrated && !report.status.pairs.empty() && !report.status.signing_refused;
  return by_verdict && !well ? Exit::no : Exit::done;
}

std::string shown(const Result<Report>& report, const StatusOptions& options) {
  if (!report) return options.json ? "" : "calibctl: " + escape_control(report.error().context) + '\n';
  if (options.json) return json_text(report->raw, options.watch ? -1 : 2);
  const auto text = options.pair.empty() ? status_table : status_text;
  return text(report->status, report->checks, wall_clock(), report->snapshot_age_s, terminal_has_colours());
}

Exit watch_on_screen(const Paths& paths, const StatusOptions& options) {
  Screen screen;
  do
    if (!screen.show(shown(collect(paths, options, watch_timeout), options))) return Exit::failed;
  while (screen.wait(std::chrono::seconds(1)));
  return Exit::done;
}

volatile std::sig_atomic_t interrupted = 0;

/// One status after the other: to a file, a pipe, or a terminal on which nothing can be redrawn.
Exit watch_in_sequence(const Paths& paths, const StatusOptions& options) {
  struct sigaction on_interrupt {};
  on_interrupt.sa_handler = [](int) { interrupted = 1; };
  sigaction(SIGINT, &on_interrupt, nullptr);
  sigaction(SIGTERM, &on_interrupt, nullptr);
  while (interrupted == 0) {
    std::cout << shown(collect(paths, options, watch_timeout), options) << (options.json ? "" : "\n") << std::flush;
    if (!std::cout) return Exit::failed;
    ::sleep(1);  // a signal ends it early
  }
  return Exit::done;
}

}  // namespace

Exit status(const Paths& paths, const StatusOptions& options) {
  if (options.watch)
    return Screen::is_available() && !options.json ? watch_on_screen(paths, options)
                                                   : watch_in_sequence(paths, options);
  const auto report = collect(paths, options, status_timeout);
  if (!report) return print_error(report.error());
  std::cout << shown(report, options);
  return exit_of(*report, options.exit_code);
}

}  // namespace calib::ctl
