#include "uplink/calibd_request.hpp"

#include <fcntl.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstring>

namespace calib::uplink {
namespace {

constexpr std::size_t max_reply_bytes = 4 * 1024 * 1024;

Result<nlohmann::json> parse_reply(std::string_view line) {
  auto reply = nlohmann::json::parse(line, nullptr, /*allow_exceptions=*/false);
  const auto text = [&](const char* key) {
    const auto found = reply.find(key);
    return found != reply.end() && found->is_string() ? found->get<std::string>() : std::string();
  };
  if (!reply.is_object() || !reply.contains("ok"))
    return fail(ErrorCode::malformed_reply, "calibd's answer is no answer");
  if (reply["ok"] == true) return reply;
  return fail(parse_error_code(text("code")).value_or(ErrorCode::failed), "calibd refuses: " + text("message"));
}

}  // namespace

void CalibdRequest::cancel() {
  if (fd_ >= 0) ::close(fd_);
  fd_ = -1;
}

Result<void> CalibdRequest::send(const nlohmann::json& request, std::chrono::seconds timeout) {
  cancel();
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  if (path_.native().size() >= sizeof address.sun_path)
    return fail(ErrorCode::bad_socket, path_.string() + " is too long for the name of a socket");
  std::memcpy(address.sun_path, path_.c_str(), path_.native().size());
  fd_ = ::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
  const std::string line = request.dump() + '\n';
  // The kernel takes a line of this length at once.
  const bool sent = ::connect(fd_, reinterpret_cast<const sockaddr*>(&address), sizeof address) == 0 &&
                    ::send(fd_, line.data(), line.size(), MSG_NOSIGNAL) == static_cast<ssize_t>(line.size());
  if (!sent) {
    const int error = errno;
    cancel();
    const bool absent = error == ENOENT || error == ECONNREFUSED || error == ENOTDIR;
    return fail(absent            ? ErrorCode::daemon_not_running
                : error == EACCES ? ErrorCode::denied
                                  : ErrorCode::failed,
                "calibd cannot be reached: " + path_.string() + ": " + std::strerror(error));
  }
  received_.clear();
  deadline_ = std::chrono::steady_clock::now() + timeout;
  return {};
}

std::optional<Result<nlohmann::json>> CalibdRequest::receive() {
  const auto ended = [this](Result<nlohmann::json> result) {
    cancel();
    return std::optional(std::move(result));
  };
  std::array<char, 65536> buffer;
  for (;;) {
    const ssize_t count = ::read(fd_, buffer.data(), buffer.size());
    if (count < 0 && errno == EINTR) continue;
    if (count < 0 && errno == EAGAIN) break;
    if (count <= 0) return ended(fail(ErrorCode::no_answer, "calibd has closed the connection"));
    received_.append(buffer.data(), static_cast<std::size_t>(count));
    if (received_.back() == '\n') return ended(parse_reply(received_));
    if (received_.size() > max_reply_bytes)
      return ended(fail(ErrorCode::malformed_reply, "calibd's answer is too long"));
  }
  if (std::chrono::steady_clock::now() < deadline_) return std::nullopt;
  return ended(fail(ErrorCode::no_answer, "calibd has not answered"));
}

}  // namespace calib::uplink
