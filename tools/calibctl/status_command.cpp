#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <csignal>
#include <fstream>
#include <iostream>

#include "calib/file.hpp"
#include "commands.hpp"
#include "control_client.hpp"
#include "status_text.hpp"
#include "text.hpp"

namespace calib::ctl {
namespace {

using nlohmann::json;

constexpr std::chrono::seconds status_timeout{10};

/// Now, by the clock of this machine since boot. Evidence of another boot, or of long ago, is stale.
BootTime boot_time() {
  std::ifstream file("/proc/sys/kernel/random/boot_id");
  std::string boot_id;
  std::getline(file, boot_id);
  timespec time{};
  ::clock_gettime(CLOCK_BOOTTIME, &time);
  return {boot_id, std::chrono::seconds(time.tv_sec) + std::chrono::nanoseconds(time.tv_nsec)};
}

WallTime now() { return std::chrono::system_clock::now().time_since_epoch(); }

/// A status as received and as parsed, with the results of verifying its records.
struct Report {
  json raw;
  Status status;
  std::vector<RecordCheck> checks;
  std::optional<double> snapshot_age_s;
};

Result<json> read_snapshot(const Paths& paths, std::optional<double>& age_s) {
  constexpr std::uint64_t most_bytes = 4 << 20;
  struct stat about {};
  const auto content = read_regular_file(paths.snapshot(), most_bytes);
  if (!content || ::stat(paths.snapshot().c_str(), &about) != 0)
    return fail(ErrorCode::daemon_not_running, "calibd does not run, and there is no snapshot of it in " +
                                                   paths.snapshot().string() +
                                                   (content ? "" : " (" + content.error().context + ")"));
  age_s = std::max(0.0, std::chrono::duration<double>(now() - std::chrono::seconds(about.st_mtim.tv_sec)).count());
  return parse_json(*content);
}

void annotate(Report& report) {
  json& daemon = report.raw["daemon"];
  daemon["running"] = report.status.running;
  if (report.snapshot_age_s) daemon["snapshot_age_s"] = *report.snapshot_age_s;
  for (std::size_t i = 0; i < report.checks.size(); ++i) {
    const RecordCheck& check = report.checks[i];
    report.raw["pairs"][i]["verdict"] = to_string(report.status.pairs[i].verdict);
    report.raw["pairs"][i]["reason"] = report.status.pairs[i].reason;
    json& record = report.raw["pairs"][i]["record"];
    if (record.is_null()) continue;
    record["verified"] = check.verified;
    record["verified_by"] = check.checked ? "calibctl" : check.verified ? "calibd" : "nobody";
    record["verification"] = check.words;
  }
}

Result<Report> collect(const Paths& paths) {
  Report report;
  auto reply = ask(paths.socket, {{"schema", 1}, {"request", "status"}}, status_timeout, [](auto) {});
  if (reply)
    reply = reply->value("status", json());
  else if (reply.error().code == ErrorCode::daemon_not_running)
    reply = read_snapshot(paths, report.snapshot_age_s);
  if (!reply) return propagate(reply);

  auto status = parse_status(*reply);
  if (!status) return propagate(status);
  report.raw = std::move(*reply);
  report.status = std::move(*status);
  expire(report.status, boot_time());
  report.status.running = !report.snapshot_age_s;
  report.checks = check_records(report.status, paths);
  annotate(report);
  return report;
}

Exit exit_of(const Report& report, bool by_verdict) {
  for (std::size_t i = 0; i < report.checks.size(); ++i)
    if (report.status.pairs[i].record && !report.checks[i].verified &&
        (report.checks[i].checked || report.status.running))
      return Exit::no;
  if (!report.status.running) return Exit::not_found;
  const bool calibrated =
      std::ranges::all_of(report.status.pairs, [](const auto& pair) { return pair.verdict == Verdict::calibrated; });
  return by_verdict && (!calibrated || report.status.pairs.empty()) ? Exit::no : Exit::done;
}

std::string shown(const Result<Report>& report, const StatusOptions& options) {
  if (!report) return options.json ? "" : "calibctl: " + escape_control(report.error().context) + '\n';
  if (options.json) return json_text(report->raw, options.watch ? -1 : 2);
  return status_text(report->status, report->checks, now(), report->snapshot_age_s, terminal_has_colours());
}

volatile std::sig_atomic_t interrupted = 0;

Exit watch(const Paths& paths, const StatusOptions& options) {
  struct sigaction on_interrupt {};
  on_interrupt.sa_handler = [](int) { interrupted = 1; };
  sigaction(SIGINT, &on_interrupt, nullptr);
  sigaction(SIGTERM, &on_interrupt, nullptr);
  const bool redraw = ::isatty(STDOUT_FILENO) == 1 && !options.json;
  while (interrupted == 0) {
    const std::string text = shown(collect(paths), options);
    std::cout << (redraw ? "\x1b[H\x1b[2J" : "") << text << (redraw || options.json ? "" : "\n") << std::flush;
    if (!std::cout) return Exit::failed;
    ::sleep(1);  // a signal ends it early
  }
  return Exit::done;
}

}  // namespace

Exit status(const Paths& paths, const StatusOptions& options) {
  if (options.watch) return watch(paths, options);
  const auto report = collect(paths);
  if (!report) return print_error(report.error());
  std::cout << shown(report, options);
  return exit_of(*report, options.exit_code);
}

}  // namespace calib::ctl
