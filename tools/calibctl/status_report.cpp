#include "status_report.hpp"

#include <sys/stat.h>
#include <time.h>

#include <algorithm>
#include <fstream>

#include "calib/file.hpp"
#include "control_client.hpp"
#include "text.hpp"

namespace calib::ctl {
namespace {

using nlohmann::json;

/// Now, by the clock of this machine since boot. Evidence of another boot, or of long ago, is stale.
BootTime boot_time() {
  std::ifstream file("/proc/sys/kernel/random/boot_id");
  std::string boot_id;
  std::getline(file, boot_id);
  timespec time{};
  ::clock_gettime(CLOCK_BOOTTIME, &time);
  return {boot_id, std::chrono::seconds(time.tv_sec) + std::chrono::nanoseconds(time.tv_nsec)};
}

Result<json> read_snapshot(const Paths& paths, std::optional<double>& age_s) {
  constexpr std::uint64_t most_bytes = 4 << 20;
  struct stat about {};
  const auto content = read_regular_file(paths.snapshot(), most_bytes);
  if (!content || ::stat(paths.snapshot().c_str(), &about) != 0)
    return fail(ErrorCode::daemon_not_running, "calibd does not run, and there is no snapshot of it in " +
                                                   paths.snapshot().string() +
                                                   (content ? "" : " (" + content.error().context + ")"));
  age_s =
      std::max(0.0, std::chrono::duration<double>(wall_clock() - std::chrono::seconds(about.st_mtim.tv_sec)).count());
  return parse_json(*content);
}

Result<json> ask_daemon(const Paths& paths, std::chrono::seconds timeout) {
  return ask(paths.socket, {{"schema", 1}, {"request", "status"}}, timeout, [](auto) {}).map([](const json& reply) {
    return reply.value("status", json());
  });
}

Result<Report> report_of(Result<json> reply, std::optional<double> snapshot_age_s) {
  if (!reply) return propagate(reply);
  auto status = parse_status(*reply);
  if (!status) return propagate(status);
  Report report{std::move(*reply), std::move(*status), {}, snapshot_age_s};
  expire(report.status, boot_time());
  report.status.running = !snapshot_age_s;
  json& daemon = report.raw["daemon"];
  daemon["running"] = report.status.running;
  if (snapshot_age_s) daemon["snapshot_age_s"] = *snapshot_age_s;
  for (std::size_t i = 0; i < report.status.pairs.size(); ++i) {
    report.raw["pairs"][i]["verdict"] = to_string(report.status.pairs[i].verdict);
    report.raw["pairs"][i]["reason"] = report.status.pairs[i].reason;
  }
  return report;
}

}  // namespace

WallTime wall_clock() { return std::chrono::system_clock::now().time_since_epoch(); }

Result<Report> ask_status(const Paths& paths, std::chrono::seconds timeout) {
  return report_of(ask_daemon(paths, timeout), std::nullopt);
}

Result<Report> ask_status_or_snapshot(const Paths& paths, std::chrono::seconds timeout) {
  std::optional<double> age_s;
  auto reply = ask_daemon(paths, timeout);
  if (!reply && reply.error().code == ErrorCode::daemon_not_running) reply = read_snapshot(paths, age_s);
  return report_of(std::move(reply), age_s);
}

Result<void> keep_pair(Report& report, const std::string& name) {
  auto& pairs = report.status.pairs;
  const auto found = std::ranges::find(pairs, name, &PairStatus::name);
  if (found == pairs.end()) {
    std::string names;
    for (const PairStatus& pair : pairs) names += (names.empty() ? "" : ", ") + pair.name;
    return fail(ErrorCode::not_found, "there is no pair '" + name + "'; there is: " + (names.empty() ? "none" : names));
  }
  report.raw["pairs"] = json::array({report.raw["pairs"].at(static_cast<std::size_t>(found - pairs.begin()))});
  pairs = {*found};
  return {};
}

void check(Report& report, const Paths& paths) {
  report.checks = check_records(report.status, paths);
  for (std::size_t i = 0; i < report.checks.size(); ++i) {
    const RecordCheck& check = report.checks[i];
    json& record = report.raw["pairs"][i]["record"];
    if (record.is_null()) continue;
    record["verified"] = check.verified;
    record["verified_by"] = check.checked ? "calibctl" : check.verified ? "calibd" : "nobody";
    record["verification"] = check.words;
  }
}

bool records_verify(const Report& report) {
  for (std::size_t i = 0; i < report.checks.size(); ++i)
    if (report.status.pairs[i].record && !report.checks[i].verified &&
        (report.checks[i].checked || report.status.running))
      return false;
  return true;
}

}  // namespace calib::ctl
