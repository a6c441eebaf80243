#include <poll.h>
#include <sys/eventfd.h>
#include <sys/signalfd.h>
#include <systemd/sd-daemon.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <atomic>
#include <csignal>
#include <cstdio>
#include <cstdlib>

#include "calib/file.hpp"
#include "uplink/log.hpp"
#include "uplink/metrics.hpp"
#include "version.hpp"

namespace calib::uplink {

void log(int priority, const std::string& line) {
  static const bool to_journal = std::getenv("JOURNAL_STREAM") != nullptr;
  const std::string escaped = escape_control(line);
  if (to_journal)
    std::fprintf(stderr, "<%d>%s\n", priority, escaped.c_str());
  else
    std::fprintf(stderr, "calib-uplink: %s\n", escaped.c_str());
}

namespace {

using namespace std::chrono_literals;
using Clock = std::chrono::steady_clock;

constexpr int exit_failed = 1;
constexpr int exit_config = 78;  // EX_CONFIG: starting again does not help

int block_signals() {
  sigset_t signals;
  sigemptyset(&signals);
  sigaddset(&signals, SIGTERM);
  sigaddset(&signals, SIGINT);
  pthread_sigmask(SIG_BLOCK, &signals, nullptr);
  return signalfd(-1, &signals, SFD_NONBLOCK | SFD_CLOEXEC);
}

/// Ends the process when leaving takes too long, as it does while libmosquitto connects: nothing is lost by that.
void limit_the_end(std::chrono::seconds most) {
  std::signal(SIGALRM, [](int) { _exit(0); });
  alarm(static_cast<unsigned>(most.count()));
}

void write_metrics(const MetricsConfig& config, const Delivery::Figures& figures, bool& failed) {
  const auto written = replace_file(config.path, metrics_text(figures));
  if (!written && !failed) log(4, written.error().context + "; it is tried again each time");
  failed = !written;
}

std::string status_line(const Delivery::Figures& figures) {
  std::string line =
      figures.calibd_answers ? std::to_string(figures.waiting) + " events wait" : "calibd does not answer";
  if (figures.mqtt) line += figures.mqtt->connected ? ", connected" : ", no connection: " + figures.mqtt->last_failure;
  return line;
}

int serve(const UplinkConfig& config, std::optional<FileSink> file) {
  const int signals = block_signals(), woken = eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC);
  if (signals < 0 || woken < 0) return log(3, "no descriptor for signals"), exit_failed;
  const auto wake = [woken] {
    const std::uint64_t one = 1;
    [[maybe_unused]] const ssize_t written = write(woken, &one, sizeof one);
  };
  Delivery delivery(config, std::move(file), wake);
  sd_notify(0, "READY=1");
  auto next_metrics = Clock::now();
  bool metrics_failed = false;
  std::string said;
  for (;;) {
    delivery.step();
    const auto figures = delivery.figures();
    if (config.metrics && Clock::now() >= next_metrics) {
      write_metrics(*config.metrics, figures, metrics_failed);
      next_metrics = Clock::now() + config.metrics->period;
    }
    if (std::string line = status_line(figures); line != said) {
      sd_notifyf(0, "STATUS=%s", escape_control(line).c_str());
      said = std::move(line);
    }
    sd_notify(0, "WATCHDOG=1");
    std::vector<pollfd> fds{{signals, POLLIN, 0}, {woken, POLLIN, 0}};
    for (const int fd : delivery.fds()) fds.push_back({fd, POLLIN, 0});
    poll(fds.data(), fds.size(), 1000);
    if ((fds[0].revents & POLLIN) != 0) break;
    std::uint64_t ignored = 0;
    [[maybe_unused]] const ssize_t count = read(woken, &ignored, sizeof ignored);
  }
  sd_notify(0, "STOPPING=1");
  limit_the_end(3s);
  return 0;
}

}  // namespace
}  // namespace calib::uplink

int main(int argc, char** argv) {
  using namespace calib::uplink;
  CLI::App app{"Sends what calibd tells its fleet, over MQTT or into a file."};
  app.set_version_flag("--version", std::string("calib-uplink ") + calib::version);
  std::filesystem::path config_file = "/etc/calibd/uplink.yaml";
  bool check_only = false;
  app.add_option("--config", config_file, "Configuration file")->capture_default_str();
  app.add_flag("--check-config", check_only, "Read the configuration, say whether it is right, and end");
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? 0 : 2;
  }
  const auto config = load_uplink_config(config_file);
  if (!config) {
    std::fprintf(stderr, "%s\n", calib::escape_control(config.error().context).c_str());
    return exit_config;
  }
  if (check_only) {
    std::printf("%s: good\n", calib::escape_control(config_file.string()).c_str());
    return 0;
  }
  std::optional<FileSink> file;
  if (config->file) {
    auto opened = FileSink::open(*config->file);
    if (!opened) return log(3, opened.error().context), exit_failed;
    file.emplace(std::move(*opened));
  }
  return serve(*config, std::move(file));
}
