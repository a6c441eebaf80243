#include "control_client.hpp"

#include <poll.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstring>
#include <iostream>
#include <utility>

#include "text.hpp"

namespace calib::ctl {
namespace {

using Clock = std::chrono::steady_clock;
constexpr std::size_t max_reply_bytes = 4 * 1024 * 1024;

struct FileDescriptor {
  int number = -1;
  explicit FileDescriptor(int fd) : number(fd) {}
  FileDescriptor(FileDescriptor&& other) noexcept : number(std::exchange(other.number, -1)) {}
  FileDescriptor& operator=(FileDescriptor&&) = delete;
  ~FileDescriptor() {
    if (number >= 0) ::close(number);
  }
};

Result<FileDescriptor> connect_to(const std::filesystem::path& path) {
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  if (path.native().size() >= sizeof address.sun_path)
    return fail(ErrorCode::bad_socket, path.string() + " is too long for the name of a socket");
  std::memcpy(address.sun_path, path.c_str(), path.native().size());
  FileDescriptor socket(::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0));
  if (::connect(socket.number, reinterpret_cast<const sockaddr*>(&address), sizeof address) == 0) return socket;
  const std::string why = path.string() + ": " + std::strerror(errno);
  if (errno == ENOENT || errno == ECONNREFUSED || errno == ENOTDIR)
    return fail(ErrorCode::daemon_not_running, "calibd does not run: " + why);
  return fail(errno == EACCES ? ErrorCode::denied : ErrorCode::failed, "calibd cannot be reached: " + why);
}

/// Sends the first byte of `line`, and a file with it.
bool send_with_file(int socket, std::string_view line, int file) {
  iovec part{const_cast<char*>(line.data()), 1};
  alignas(cmsghdr) std::array<char, CMSG_SPACE(sizeof file)> control{};
  msghdr message{};
  message.msg_iov = &part;
  message.msg_iovlen = 1;
  message.msg_control = control.data();
  message.msg_controllen = control.size();
  cmsghdr* const rights = CMSG_FIRSTHDR(&message);
  rights->cmsg_level = SOL_SOCKET;
  rights->cmsg_type = SCM_RIGHTS;
  rights->cmsg_len = CMSG_LEN(sizeof file);
  std::memcpy(CMSG_DATA(rights), &file, sizeof file);
  return ::sendmsg(socket, &message, MSG_NOSIGNAL) == 1;
}

bool send_all(int socket, std::string_view line, int file) {
  if (file >= 0) {
    if (!send_with_file(socket, line, file)) return false;
    line.remove_prefix(1);
  }
  while (!line.empty()) {
    const ssize_t sent = ::send(socket, line.data(), line.size(), MSG_NOSIGNAL);
    if (sent < 0 && errno != EINTR) return false;
    if (sent > 0) line.remove_prefix(static_cast<std::size_t>(sent));
  }
  return true;
}

/// The reply without its newline.
Result<std::string> receive_line(int socket, std::chrono::seconds timeout,
                                 const std::function<void(std::chrono::seconds)>& waiting) {
  const auto start = Clock::now();
  std::string line;
  std::array<char, 65536> buffer;
  for (;;) {
    pollfd readable{socket, POLLIN, 0};
    const int ready = ::poll(&readable, 1, 1000);
    const auto waited = std::chrono::duration_cast<std::chrono::seconds>(Clock::now() - start);
    if (ready == 0) {
      waiting(waited);
      if (waited >= timeout)
        return fail(ErrorCode::no_answer, "calibd has not answered for " + std::to_string(waited.count()) + " s");
    }
    if (ready <= 0) continue;
    const ssize_t received = ::read(socket, buffer.data(), buffer.size());
    if (received < 0 && errno == EINTR) continue;
    if (received <= 0)
      return fail(ErrorCode::malformed_reply, "calibd closed the connection before the answer was complete");
    line.append(buffer.data(), static_cast<std::size_t>(received));
    if (const auto end = line.find('\n'); end != std::string::npos) return line.substr(0, end);
    if (line.size() > max_reply_bytes) return fail(ErrorCode::malformed_reply, "the answer is longer than 4 MiB");
  }
}

}  // namespace

Result<nlohmann::json> ask(const std::filesystem::path& path, const nlohmann::json& question,
                           std::chrono::seconds timeout, const std::function<void(std::chrono::seconds)>& waiting,
                           int file) {
  const auto socket = connect_to(path);
  if (!socket) return propagate(socket);
  if (!send_all(socket->number, question.dump() + '\n', file))
    return fail(ErrorCode::no_answer, std::string("calibd closed the connection: ") + std::strerror(errno));
  const auto line = receive_line(socket->number, timeout, waiting);
  if (!line) return propagate(line);
  nlohmann::json reply = parse_json(*line);
  if (!reply.is_object() || !reply.contains("ok") || !reply["ok"].is_boolean())
    return fail(ErrorCode::malformed_reply, "the answer is not an object with \"ok\"");
  if (reply["ok"].get<bool>()) return reply;
  if (!reply.contains("code") || !reply["code"].is_string() || !reply.contains("message") ||
      !reply["message"].is_string())
    return fail(ErrorCode::malformed_reply, "calibd refused the request without a reason");
  const auto code = parse_error_code(reply["code"].get_ref<const std::string&>());
  return fail(code.value_or(ErrorCode::failed), reply["message"].get<std::string>());
}

void show_waiting(std::chrono::seconds waited) {
  if (::isatty(STDERR_FILENO) == 1) std::cerr << "\rwaiting for calibd, " << waited.count() << " s " << std::flush;
}

void clear_waiting() {
  if (::isatty(STDERR_FILENO) == 1) std::cerr << "\r\x1b[K" << std::flush;
}

}  // namespace calib::ctl
