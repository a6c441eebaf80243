#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <cstdlib>
#include <iostream>

#include "calib/signature.hpp"
#include "commands.hpp"

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

Exit check_config(const std::filesystem::path& file) {
  const std::string config_option = "--config=" + file.string();
  const pid_t child = ::fork();
  if (child == 0) become_calibd(config_option);
  int ended = 0;
  while (child > 0 && ::waitpid(child, &ended, 0) < 0 && errno == EINTR) {
  }
  if (child < 0 || !WIFEXITED(ended))
    return print_error({ErrorCode::failed, "calibd ended abnormally while it read the file"});
  if (WEXITSTATUS(ended) == exec_failed)
    return print_error({ErrorCode::not_found, "there is no calibd beside calibctl or in PATH to check the file"});
  return WEXITSTATUS(ended) == 0 ? Exit::done : Exit::failed;
}

Exit keygen(const std::filesystem::path& file) {
  const SigningKey key = SigningKey::generate();
  if (const auto saved = key.save(file); !saved) return print_error(saved.error());
  std::filesystem::path public_file = file;
  public_file.replace_extension(".pub");
  std::cout << "Key " << key.public_key().id_text() << " made.\n"
            << "Secret key, for signing_key in calibd.yaml: " << escape_control(file.string()) << '\n'
            << "Public key, for whoever verifies:           " << escape_control(public_file.string()) << '\n';
  return Exit::done;
}

}  // namespace calib::ctl
