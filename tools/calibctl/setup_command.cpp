#include <fcntl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <iostream>
#include <nlohmann/json.hpp>

#include "calib/signature.hpp"
#include "commands.hpp"
#include "text.hpp"

namespace calib::ctl {
namespace {

constexpr int exec_failed = 127;

/// The variables that systemd sets for calibd.service: defaults of keys that a configuration may omit.
void set_unit_environment() {
  constexpr int keep = 0;
  ::setenv("STATE_DIRECTORY", "/var/lib/calibd", keep);
  ::setenv("RUNTIME_DIRECTORY", "/run/calibd", keep);
  ::setenv("CREDENTIALS_DIRECTORY", "/run/credentials/calibd.service", keep);
}

/// What the other end of a pipe receives from here on goes into `pipe_end`.
void redirect(int pipe_end) {
  ::dup2(pipe_end, STDOUT_FILENO);
  ::dup2(pipe_end, STDERR_FILENO);
}

/// What calibd printed of `file`, as JSON: its lines begin with the file's name.
nlohmann::json check_json(const std::filesystem::path& file, std::string_view printed, bool valid) {
  constexpr std::string_view warning = "warning: ";
  auto warnings = nlohmann::json::array();
  nlohmann::json error;
  const std::string prefix = escape_control(file.string()) + ": ";
  while (!printed.empty()) {
    const std::string_view line = printed.substr(0, printed.find('\n'));
    printed.remove_prefix(std::min(line.size() + 1, printed.size()));
    const std::string_view said = line.starts_with(prefix) ? line.substr(prefix.size()) : line;
    if (said.starts_with(warning))
      warnings.push_back(said.substr(warning.size()));
    else if (!valid)
      error = said;
  }
  return {
      {"schema", 1}, {"file", file.string()}, {"valid", valid}, {"error", error}, {"warnings", std::move(warnings)}};
}

/// Replaces this process by the calibd beside this program, or else by the one in PATH: only calibd has a parser of
/// configurations.
[[noreturn]] void become_calibd(const std::string& config_option) {
  set_unit_environment();
  std::error_code ignored;
  const std::filesystem::path beside =
      std::filesystem::read_symlink("/proc/self/exe", ignored).replace_filename("calibd");
  ::execl(beside.c_str(), "calibd", "--check-config", config_option.c_str(), nullptr);
  ::execlp("calibd", "calibd", "--check-config", config_option.c_str(), nullptr);
  ::_exit(exec_failed);
}

}  // namespace

Exit check_config(const std::filesystem::path& file, bool as_json) {
  const std::string config_option = "--config=" + file.string();
  std::array<int, 2> pipe{-1, -1};
  if (as_json && ::pipe2(pipe.data(), O_CLOEXEC) != 0)
    return print_error({ErrorCode::failed, "there is no pipe to calibd: " + std::string(std::strerror(errno))});
  const pid_t child = ::fork();
  if (child == 0) {
    if (as_json) redirect(pipe[1]);
    become_calibd(config_option);
  }
  std::string printed;
  if (as_json) {
    ::close(pipe[1]);
    std::array<char, 4096> buffer;
    ssize_t got = 0;
    while ((got = ::read(pipe[0], buffer.data(), buffer.size())) > 0 || (got < 0 && errno == EINTR))
      if (got > 0) printed.append(buffer.data(), static_cast<std::size_t>(got));
    ::close(pipe[0]);
  }
  int ended = 0;
  while (child > 0 && ::waitpid(child, &ended, 0) < 0 && errno == EINTR) {
  }
  if (child < 0 || !WIFEXITED(ended))
    return print_error({ErrorCode::failed, "calibd ended abnormally while it read the file"});
  if (WEXITSTATUS(ended) == exec_failed)
    return print_error({ErrorCode::not_found, "there is no calibd beside calibctl or in PATH to check the file"});
  const bool valid = WEXITSTATUS(ended) == 0;
  if (as_json) std::cout << json_text(check_json(file, printed, valid), 2);
  return valid ? Exit::done : Exit::failed;
}

Exit keygen(const std::filesystem::path& file, bool as_json) {
  const SigningKey key = SigningKey::generate();
  if (const auto saved = key.save(file); !saved) return print_error(saved.error());
  std::filesystem::path public_file = file;
  public_file.replace_extension(".pub");
  if (as_json) {
    std::cout << json_text({{"schema", 1},
                            {"key", key.public_key().id_text()},
                            {"secret_key", file.string()},
                            {"public_key", public_file.string()}},
                           2);
    return Exit::done;
  }
  std::cout << "Key " << key.public_key().id_text() << " made.\n"
            << "Secret key, for signing_key in calibd.yaml: " << escape_control(file.string()) << '\n'
            << "Public key, for whoever verifies:           " << escape_control(public_file.string()) << '\n';
  return Exit::done;
}

}  // namespace calib::ctl
