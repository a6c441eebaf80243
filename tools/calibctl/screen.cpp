#include "screen.hpp"

#include <signal.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include <cerrno>
#include <cstdlib>
#include <string>

namespace calib::ctl {
namespace {

// Of xterm, and of every terminal that is not "dumb".
constexpr std::string_view alternate_screen = "\x1b[?1049h", cursor_off = "\x1b[?25l", wrap_off = "\x1b[?7l";
constexpr std::string_view main_screen = "\x1b[?1049l", cursor_on = "\x1b[?25h", wrap_on = "\x1b[?7h";
constexpr std::string_view home = "\x1b[H", to_end_of_line = "\x1b[K", to_end_of_screen = "\x1b[J";

/// In one piece, so that the terminal does not show half of it.
bool write_all(std::string_view bytes) {
  while (!bytes.empty()) {
    const ssize_t written = ::write(STDOUT_FILENO, bytes.data(), bytes.size());
    if (written < 0 && errno != EINTR) return false;
    if (written > 0) bytes.remove_prefix(static_cast<std::size_t>(written));
  }
  return true;
}

sigset_t awaited() {
  sigset_t signals;
  sigemptyset(&signals);
  for (const int signal : {SIGINT, SIGTERM, SIGHUP, SIGTSTP, SIGWINCH}) sigaddset(&signals, signal);
  return signals;
}

std::size_t rows() {
  winsize size{};
  return ::ioctl(STDOUT_FILENO, TIOCGWINSZ, &size) == 0 && size.ws_row > 0 ? size.ws_row : 24;
}

}  // namespace

bool Screen::is_available() {
  const char* const terminal = std::getenv("TERM");
  return ::isatty(STDOUT_FILENO) == 1 && terminal != nullptr && std::string_view(terminal) != "dumb";
}

Screen::Screen() {
  // Blocked, they wait for `wait`: none ends the program before the terminal is as it was.
  const sigset_t signals = awaited();
  sigprocmask(SIG_BLOCK, &signals, nullptr);
  enter();
}

Screen::~Screen() { leave(); }

void Screen::enter() { write_all(std::string(alternate_screen).append(cursor_off).append(wrap_off).append(home)); }

void Screen::leave() { write_all(std::string(wrap_on).append(cursor_on).append(main_screen)); }

bool Screen::show(std::string_view text) {
  std::string bytes(home);
  for (std::size_t row = 0, last = rows(); row < last && !text.empty(); ++row) {
    const auto end = text.find('\n');
    // No newline after the last row: it would scroll.
    bytes.append(row == 0 ? "" : "\r\n").append(text.substr(0, end)).append(to_end_of_line);
    text.remove_prefix(end == std::string_view::npos ? text.size() : end + 1);
  }
  if (text.empty()) bytes.append(to_end_of_screen);
  return write_all(bytes);
}

bool Screen::wait(std::chrono::seconds pause) {
  const sigset_t signals = awaited();
  const timespec time{pause.count(), 0};
  const int signal = sigtimedwait(&signals, nullptr, &time);
  if (signal == SIGTSTP) {
    leave();
    raise(SIGSTOP);  // goes on here after SIGCONT
    enter();
  }
  return signal != SIGINT && signal != SIGTERM && signal != SIGHUP;
}

}  // namespace calib::ctl
