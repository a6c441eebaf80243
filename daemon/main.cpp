#include <malloc.h>
#include <spdlog/sinks/stdout_color_sinks.h>
#include <spdlog/spdlog.h>
#include <sys/signalfd.h>
#include <systemd/sd-daemon.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <atomic>
#include <chrono>
#include <csignal>
#include <cstdio>
#include <ctime>
#include <fstream>
#include <iterator>
#include <opencv2/core.hpp>
#include <sstream>
#include <thread>

#include "build_id.hpp"
#include "config_check.hpp"
#include "control.hpp"
#include "dds/reach.hpp"
#include "file_limit.hpp"
#include "journal.hpp"
#include "message_ids.hpp"
#include "pair_topics.hpp"
#include "service.hpp"
#include "signing_key.hpp"
#include "version.hpp"

namespace {

using calib::Error;
using calib::ErrorCode;
using calib::Result;

constexpr int exit_failed = 1;
constexpr int exit_config = 78;  // EX_CONFIG: starting again does not help

/// The first and the second folder that the service manager gave; it separates them by colons.
std::array<std::optional<std::filesystem::path>, 2> folders_from_environment(const char* name) {
  const char* value = std::getenv(name);
  std::array<std::optional<std::filesystem::path>, 2> folders;
  std::istringstream list(value != nullptr ? value : "");
  std::string folder;
  for (auto& one : folders)
    if (std::getline(list, folder, ':') && !folder.empty()) one = folder;
  return folders;
}

/// Lets glibc return freed memory to the system at once: calibd needs large buffers for part of a second per pair, and
/// then waits for seconds. By default each thread has a heap of its own, and the thresholds grow to the size of the
/// largest buffers. To be called before threads start. No effect with AddressSanitizer, which has its own allocator.
void return_freed_memory() {
#ifdef __GLIBC__
  constexpr int threshold_bytes = 128 << 10;  // glibc's initial value; fixed once it is set
  mallopt(M_ARENA_MAX, 1);
  mallopt(M_MMAP_THRESHOLD, threshold_bytes);
  mallopt(M_TRIM_THRESHOLD, threshold_bytes);
#endif
}

std::string file_bytes(const std::filesystem::path& file) {
  std::ifstream in(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

int complain(const Error& error, int code, std::string_view message_id = calib::message_ids::start_refused) {
  calib::journal(3, message_id, {error.context, {.cause = std::string(calib::to_string(error.code))}});
  sd_notifyf(0, "STATUS=%s", calib::escape_control(error.context).c_str());
  return code;
}

/// Signals come as readable bytes, to the one thread that serves the control socket.
Result<int> block_signals() {
  sigset_t signals;
  sigemptyset(&signals);
  sigaddset(&signals, SIGTERM);
  sigaddset(&signals, SIGINT);
  sigaddset(&signals, SIGHUP);
  pthread_sigmask(SIG_BLOCK, &signals, nullptr);
  const int fd = signalfd(-1, &signals, SFD_NONBLOCK | SFD_CLOEXEC);
  if (fd < 0) return calib::fail(ErrorCode::signals, "signalfd failed");
  return fd;
}

Result<void> make_directories(const calib::Config& config) {
  // Where the chain's head cannot be remembered, that is told as `store_failed`, until it can.
  std::error_code ignored;
  std::filesystem::create_directories(config.head_dir, ignored);
  for (const auto& directory : {config.state_dir, config.runtime_dir}) {
    std::error_code error;
    std::filesystem::create_directories(directory, error);
    if (error || access(directory.c_str(), W_OK) != 0)
      return calib::fail(ErrorCode::bad_directory,
                         directory.string() + " cannot be written: " + (error ? error.message() : "permission denied") +
                             "; make it, or choose another in the configuration");
  }
  return {};
}

Result<calib::Provenance> provenance(const calib::Config& config) {
  std::string boot_id = file_bytes("/proc/sys/kernel/random/boot_id");
  boot_id.erase(boot_id.find_last_not_of('\n') + 1);
  const auto software = calib::build_id();
  if (!software) return propagate(software);
  return calib::Provenance{config.vehicle, config.sha256, calib::version, calib::sha256_hex(*software), boot_id};
}

/// The public key that lies beside the secret one, or where calibctl looks for it: records that the secret key has not
/// signed may verify with it.
std::optional<calib::PublicKey> trusted_key(std::filesystem::path signing_key) {
  for (const std::filesystem::path& file :
       {signing_key.replace_extension(".pub"), std::filesystem::path("/etc/calibd/signing.pub")})
    if (auto key = calib::load_public_key(file)) return *key;
  return std::nullopt;
}

/// The one that came first; 0 when none has.
int read_signal(int signal_fd) {
  signalfd_siginfo about{};
  return read(signal_fd, &about, sizeof about) == sizeof about ? static_cast<int>(about.ssi_signo) : 0;
}

/// Whether the service manager was told that the configuration is being read.
std::atomic<bool> reloading = false;

void tell_reloaded() {
  if (reloading.exchange(false)) sd_notify(0, "READY=1");
}

/// The configuration as it is now, checked as at a start.
Result<calib::Config> read_config_again(const std::filesystem::path& file, const calib::DefaultFolders& defaults) {
  timespec now{};
  clock_gettime(CLOCK_MONOTONIC, &now);
  reloading = true;
  sd_notifyf(0, "RELOADING=1\nMONOTONIC_USEC=%lld", now.tv_sec * 1'000'000LL + now.tv_nsec / 1000);
  auto config = calib::load_config(file, defaults);
  if (!config) return config;
  if (const auto files = calib::check_files(*config); !files)
    return calib::fail(files.error().code, file.string() + ": " + files.error().context);
  return config;
}

Result<std::unique_ptr<calib::Service>> make_service(calib::Config config, calib::SigningKey key,
                                                     const calib::ControlSocket& control,
                                                     std::function<Result<calib::Config>()> read_config) {
  auto known = provenance(config);
  if (!known) return propagate(known);
  auto ledger = calib::Ledger::open(config.state_dir, config.head_dir, std::move(key), std::move(*known), config.feed,
                                    trusted_key(config.signing_key));
  if (!ledger) return propagate(ledger);
  const auto log = [](int priority, const std::string& line) {
    calib::journal(priority, calib::message_ids::dds_complains, line);
  };
  auto bus = calib::Bus::open(config.dds.domain, config.dds.interface, calib::max_sample_bytes(config), log,
                              {config.dds.multicast, config.dds.peers});
  if (std::getenv("CYCLONEDDS_URI") != nullptr)
    log(5,
        "CYCLONEDDS_URI is set, and calibd does not read it; the key dds of the configuration has what it needs "
        "(interface, peers, multicast)");
  if (!bus) return propagate(bus);
  return calib::Service::make(
      std::move(config), std::move(*ledger), calib::make_network(std::move(*bus)),
      {.status_changed = [&control] { control.interrupt(); }, .read_config = std::move(read_config)});
}

/// Serves the control socket and shows the status until a signal comes, while the service does its work on a thread of
/// its own. What is shown does not wait for that thread, nor does the end for long: decisions have been written, and
/// what is lost then is a minute of evidence at most.
int serve(calib::Service& service, calib::ControlSocket& control, int signal_fd) {
  using namespace std::chrono_literals;
  std::atomic<bool> ended = false;
  Result<void> result;
  std::atomic<std::chrono::steady_clock::duration> shown = std::chrono::steady_clock::now().time_since_epoch();
  std::thread worker([&] {
    pthread_setname_np(pthread_self(), "pairs");
    // The watchdog is fed by steps of the pipeline and by nothing else; and no more when nothing is shown any more.
    result = service.run([&] {
      if (std::chrono::steady_clock::now().time_since_epoch() - shown.load() < 30s) sd_notify(0, "WATCHDOG=1");
    });
    ended = true;
    control.interrupt();
  });
  const auto show = [&] {
    if (const auto verdicts = service.show()) sd_notifyf(0, "STATUS=%s", calib::escape_control(*verdicts).c_str());
    shown = std::chrono::steady_clock::now().time_since_epoch();
  };
  show();
  sd_notifyf(0, "READY=1\nMAINPID=%d", static_cast<int>(getpid()));
  spdlog::info("calibd {} watches", calib::version);
  const auto handle = [&](calib::ClientRequest client) {
    const auto reply = [send = client.reply](const calib::ControlReply& made) { send(encode_reply(made)); };
    const auto reply_to_reload = [reply](const calib::ControlReply& made) {
      tell_reloaded();
      reply(made);
    };
    try {
      auto request = calib::decode_request(client.request);
      if (!request)
        reply(request.error());
      else if (std::holds_alternative<calib::ReloadRequest>(*request))
        service.ask({std::move(*request), client.peer, reply_to_reload, client.client_gone, client.file});
      else
        service.ask({std::move(*request), client.peer, reply, client.client_gone, client.file});
    } catch (const std::exception& exception) {
      reply(calib::Error{ErrorCode::failed, exception.what()});
    }
  };
  // What changes is shown at once. Once a second diagnostics are due, and a verdict may have expired.
  const auto now = [] { return std::chrono::steady_clock::now(); };
  auto due = now() + 1s;
  const auto reload = [&] {
    service.ask({calib::ReloadRequest{}, {.may_change = true}, [](const calib::ControlReply&) { tell_reloaded(); }});
  };
  while (!ended) {
    if (control.serve(std::chrono::ceil<std::chrono::milliseconds>(std::max(due - now(), 0ns)), signal_fd, handle)) {
      const int came = read_signal(signal_fd);
      if (came == SIGHUP) reload();
      if (came == SIGTERM || came == SIGINT) break;
    }
    show();
    if (now() >= due) due = std::max(due + 1s, now());
  }
  sd_notify(0, "STOPPING=1");
  service.stop();
  const auto patience = std::chrono::steady_clock::now() + 1s;
  while (!ended && std::chrono::steady_clock::now() < patience) std::this_thread::sleep_for(10ms);
  if (!ended) {
    spdlog::warn("calibd ends in the middle of its work on a pair");
    _exit(0);
  }
  worker.join();
  show();
  if (!result) return complain(result.error(), exit_failed, calib::message_ids::store_failed);
  spdlog::info("calibd ends");
  return 0;
}

int report_check(const std::filesystem::path& file, const calib::Config& config) {
  const std::string name = calib::escape_control(file.string());
  if (const auto files = calib::check_files(config); !files) {
    std::fprintf(stderr, "%s: %s\n", name.c_str(), calib::escape_control(files.error().context).c_str());
    return exit_config;
  }
  auto slips = calib::probable_slips(config);
  if (auto obstacle = calib::obstacle_to_domain(config.dds.domain, config.dds.interface, config.dds.multicast))
    slips.push_back(std::move(obstacle->context));
  for (const std::string& slip : slips) std::printf("%s: warning: %s\n", name.c_str(), slip.c_str());
  std::printf("%s: %s, %zu pair%s\n", name.c_str(), slips.empty() ? "good" : "valid", config.pairs.size(),
              config.pairs.size() == 1 ? "" : "s");
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  return_freed_memory();
  CLI::App app{"Watches whether cameras and LiDARs still are where their calibration says."};
  app.set_version_flag("--version", std::string("calibd ") + calib::version);
  std::filesystem::path config_file = "/etc/calibd/calibd.yaml";
  bool check_only = false;
  app.add_option("--config", config_file, "Configuration file")->capture_default_str();
  app.add_flag("--check-config", check_only, "Read the configuration, say whether it is right, and end");
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? 0 : 2;
  }
  spdlog::set_default_logger(spdlog::stderr_color_mt("calibd"));
  // Under systemd the journal has the time already.
  spdlog::set_pattern(std::getenv("JOURNAL_STREAM") != nullptr ? "%v" : "%Y-%m-%dT%H:%M:%S.%e %^%l%$ %v");

  if (auto enough = calib::require_open_files(); !enough && !check_only) return complain(enough.error(), exit_failed);
  const auto signal_fd = block_signals();  // before anything that takes time: none of them shall end calibd half way
  if (!signal_fd) return complain(signal_fd.error(), exit_failed);
  const auto state = folders_from_environment("STATE_DIRECTORY");
  const calib::DefaultFolders defaults{state[0], folders_from_environment("RUNTIME_DIRECTORY")[0],
                                       folders_from_environment("CREDENTIALS_DIRECTORY")[0], state[1]};
  auto config = calib::load_config(config_file, defaults);
  if (!config && check_only) {
    std::fprintf(stderr, "%s\n", calib::escape_control(config.error().context).c_str());
    return exit_config;
  }
  if (!config) return complain(config.error(), exit_config);
  if (check_only) return report_check(config_file, *config);
  // One core is what a vehicle gives; and one thread more would not change any result.
  cv::setNumThreads(1);
  auto key = calib::load_signing_key(*config);
  if (!key) return complain(key.error(), exit_config);
  if (auto made = make_directories(*config); !made) return complain(made.error(), exit_config);
  auto control = calib::ControlSocket::open(config->runtime_dir / "control.sock");
  if (!control) return complain(control.error(), exit_failed);
  auto service = make_service(std::move(*config), std::move(*key), *control,
                              [&] { return read_config_again(config_file, defaults); });
  if (!service) {
    // Records that do not verify are for a person to look at, as is what the configuration asks for in vain; starting
    // again would not mend them.
    const bool permanent =
        service.error().code == ErrorCode::bad_config || service.error().code == ErrorCode::bad_signature ||
        service.error().code == ErrorCode::broken_chain || service.error().code == ErrorCode::wrong_key ||
        service.error().code == ErrorCode::malformed_record || service.error().code == ErrorCode::other_vehicle;
    return complain(service.error(), permanent ? exit_config : exit_failed);
  }
  return serve(**service, *control, *signal_fd);
}
