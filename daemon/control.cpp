#include "control.hpp"

#include <fcntl.h>
#include <grp.h>
#include <poll.h>
#include <pwd.h>
#include <sys/eventfd.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <fstream>

namespace calib {
namespace {

constexpr std::size_t max_request_bytes = 64 * 1024;
constexpr std::size_t max_connections = 16;
constexpr std::chrono::seconds request_time{10};
/// A recalibration takes minutes.
constexpr std::chrono::minutes reply_time{10};

std::string system_error(const std::string& what) { return what + ": " + std::strerror(errno); }

bool is_member(uid_t uid, gid_t group) {
  const passwd* user = getpwuid(uid);
  if (user == nullptr) return false;
  int count = 64;
  std::vector<gid_t> groups(count);
  if (getgrouplist(user->pw_name, user->pw_gid, groups.data(), &count) < 0) {
    groups.resize(count);
    if (getgrouplist(user->pw_name, user->pw_gid, groups.data(), &count) < 0) return false;
  }
  groups.resize(count);
  return std::ranges::find(groups, group) != groups.end();
}

bool is_uplink(uid_t uid) {
  const passwd* user = getpwnam("calib-uplink");
  return user != nullptr && user->pw_uid == uid;
}

/// What pam_loginuid has noted for the session of a process.
std::optional<uid_t> login_of(pid_t pid) {
  constexpr uid_t unset = static_cast<uid_t>(-1);
  std::ifstream file("/proc/" + std::to_string(pid) + "/loginuid");
  uid_t login = unset;
  return file >> login && login != unset ? std::optional(login) : std::nullopt;
}

Result<Peer> peer_of(int fd) {
  ucred credentials{};
  socklen_t size = sizeof credentials;
  if (getsockopt(fd, SOL_SOCKET, SO_PEERCRED, &credentials, &size) != 0)
    return fail(ErrorCode::control_socket, system_error("SO_PEERCRED"));
  const bool may_change = credentials.uid == 0 || credentials.uid == geteuid() || credentials.gid == getegid() ||
                          is_member(credentials.uid, getegid());
  const bool may_change_keys = credentials.uid == 0 || credentials.uid == geteuid();
  return Peer{credentials.uid, credentials.pid, login_of(credentials.pid),
              may_change,      may_change_keys, may_change || is_uplink(credentials.uid)};
}

/// As `read`, and takes the file that came along.
ssize_t receive(int fd, char* buffer, std::size_t size, std::shared_ptr<const SentFile>& file) {
  iovec part{buffer, size};
  alignas(cmsghdr) char control[CMSG_SPACE(sizeof(int))];
  msghdr message{};
  message.msg_iov = &part;
  message.msg_iovlen = 1;
  message.msg_control = control;
  message.msg_controllen = CMSG_LEN(sizeof(int));  // one file; the kernel closes any more, for which there is no room
  const ssize_t count = recvmsg(fd, &message, MSG_CMSG_CLOEXEC);
  if (count < 0) return count;
  const cmsghdr* const rights = CMSG_FIRSTHDR(&message);
  if (rights != nullptr && rights->cmsg_level == SOL_SOCKET && rights->cmsg_type == SCM_RIGHTS) {
    int sent = -1;
    std::memcpy(&sent, CMSG_DATA(rights), sizeof sent);
    file = std::make_shared<const SentFile>(sent);
  }
  return count;
}

bool is_listening(const sockaddr_un& address) {
  const int fd = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
  const bool connected = fd >= 0 && connect(fd, reinterpret_cast<const sockaddr*>(&address), sizeof address) == 0;
  if (fd >= 0) close(fd);
  return connected;
}

}  // namespace

nlohmann::json refusal(std::string_view code, std::string_view message) {
  return {{"ok", false}, {"code", code}, {"message", message}};
}

Result<nlohmann::json> parse_request(std::string_view line) {
  if (line.size() > max_request_bytes) return fail(ErrorCode::bad_request, "a request is one line of at most 64 KiB");
  auto request = nlohmann::json::parse(line, nullptr, /*allow_exceptions=*/false);
  if (!request.is_object() || request.value("schema", nlohmann::json()) != 1 || !request.contains("request") ||
      !request["request"].is_string())
    return fail(ErrorCode::bad_request, R"(a request is a JSON object with "schema": 1 and "request")");
  return request;
}

void ControlSocket::Replies::wake() const {
  const std::uint64_t one = 1;
  [[maybe_unused]] const ssize_t written = write(wake_fd, &one, sizeof one);
}

SentFile::~SentFile() {
  if (fd >= 0) close(fd);
}

ControlSocket::Replies::~Replies() {
  if (wake_fd >= 0) close(wake_fd);
}

Result<ControlSocket> ControlSocket::open(const std::filesystem::path& path) {
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  if (path.string().size() >= sizeof address.sun_path)
    return fail(ErrorCode::control_socket,
                "the path " + path.string() + " is too long for a socket; choose a shorter runtime_dir");
  std::strcpy(address.sun_path, path.c_str());
  if (is_listening(address))
    return fail(ErrorCode::control_socket, "another calibd listens on " + path.string() + "; stop it first");
  std::error_code ignored;
  std::filesystem::remove(path, ignored);

  ControlSocket socket;
  socket.replies_ = std::make_shared<Replies>();
  socket.replies_->wake_fd = eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC);
  socket.listen_fd_ = ::socket(AF_UNIX, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
  if (socket.replies_->wake_fd < 0 || socket.listen_fd_ < 0)
    return fail(ErrorCode::control_socket, system_error("socket"));
  // Made without rights for others; the group is the daemon's own.
  const mode_t before = umask(0117);
  const bool bound = bind(socket.listen_fd_, reinterpret_cast<const sockaddr*>(&address), sizeof address) == 0;
  umask(before);
  if (!bound || listen(socket.listen_fd_, max_connections) != 0)
    return fail(ErrorCode::control_socket, system_error("cannot listen on " + path.string()));
  socket.path_ = path;
  return socket;
}

ControlSocket::ControlSocket(ControlSocket&& other) noexcept
    : listen_fd_(std::exchange(other.listen_fd_, -1)),
      path_(std::move(other.path_)),
      next_id_(other.next_id_),
      connections_(std::move(other.connections_)),
      replies_(std::move(other.replies_)) {
  other.path_.clear();
}

ControlSocket::~ControlSocket() {
  for (const auto& [id, connection] : connections_) close(connection.fd);
  if (listen_fd_ < 0) return;
  close(listen_fd_);
  std::error_code ignored;
  if (!path_.empty()) std::filesystem::remove(path_, ignored);
}

void ControlSocket::accept_connection() {
  const int fd = accept4(listen_fd_, nullptr, nullptr, SOCK_NONBLOCK | SOCK_CLOEXEC);
  if (fd < 0) return;
  const auto peer = peer_of(fd);
  if (!peer || connections_.size() >= max_connections) {
    close(fd);
    return;
  }
  Connection connection;
  connection.fd = fd;
  connection.peer = *peer;
  connection.deadline = std::chrono::steady_clock::now() + request_time;
  connections_.emplace(next_id_++, std::move(connection));
}

void ControlSocket::drop(std::uint64_t id) {
  const auto found = connections_.find(id);
  *found->second.gone = true;
  close(found->second.fd);
  connections_.erase(found);
}

bool ControlSocket::read_request(std::uint64_t id, Connection& connection,
                                 const std::function<void(ClientRequest)>& handle) {
  char buffer[4096];
  const ssize_t count = receive(connection.fd, buffer, sizeof buffer, connection.file);
  if (count < 0) return errno == EAGAIN || errno == EINTR;
  // A client may close its writing side and still read; one that closes it before its request is gone.
  if (count == 0) return connection.requested;
  if (connection.requested) return true;  // one request to a connection; the rest is not read into memory
  connection.received.append(buffer, static_cast<std::size_t>(count));
  const auto end = connection.received.find('\n');
  if (end == std::string::npos && connection.received.size() <= max_request_bytes) return true;

  connection.requested = true;
  connection.deadline = std::chrono::steady_clock::now() + reply_time;
  const auto reply = [replies = replies_, id](const nlohmann::json& object) {
    const std::lock_guard lock(replies->mutex);
    replies->lines[id] = object.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace) + '\n';
    replies->wake();
  };
  auto request = parse_request(std::string_view(connection.received).substr(0, end));
  connection.received.clear();
  if (!request)
    reply(refusal(to_string(request.error().code), request.error().context));
  else
    handle({*std::move(request), connection.peer, reply, connection.gone, std::move(connection.file)});
  return true;
}

bool ControlSocket::send_reply(Connection& connection) {
  const ssize_t count = send(connection.fd, connection.to_send.data(), connection.to_send.size(), MSG_NOSIGNAL);
  if (count < 0) return errno == EAGAIN || errno == EINTR;
  connection.to_send.erase(0, static_cast<std::size_t>(count));
  return !connection.to_send.empty();
}

void ControlSocket::collect_replies() {
  std::uint64_t ignored = 0;
  [[maybe_unused]] const ssize_t count = read(replies_->wake_fd, &ignored, sizeof ignored);
  const std::lock_guard lock(replies_->mutex);
  for (auto& [id, line] : replies_->lines)
    if (const auto found = connections_.find(id); found != connections_.end()) found->second.to_send = std::move(line);
  replies_->lines.clear();
}

void ControlSocket::interrupt() const {
  replies_->interrupted = true;
  replies_->wake();
}

bool ControlSocket::serve(std::chrono::milliseconds timeout, int other_fd,
                          const std::function<void(ClientRequest)>& handle) {
  const auto end = std::chrono::steady_clock::now() + timeout;
  for (;;) {
    std::vector<pollfd> fds{{other_fd, POLLIN, 0}, {listen_fd_, POLLIN, 0}, {replies_->wake_fd, POLLIN, 0}};
    std::vector<std::uint64_t> ids;
    auto until = end;
    for (const auto& [id, connection] : connections_) {
      // A hang-up is always reported; nothing more is read from a client that waits for its reply.
      const short events = !connection.to_send.empty() ? POLLOUT : connection.requested ? short{0} : POLLIN;
      fds.push_back({connection.fd, events, 0});
      ids.push_back(id);
      until = std::min(until, connection.deadline);
    }
    const auto left = std::chrono::ceil<std::chrono::milliseconds>(until - std::chrono::steady_clock::now());
    if (poll(fds.data(), fds.size(), static_cast<int>(std::max<std::int64_t>(0, left.count()))) < 0 && errno != EINTR)
      return false;
    if ((fds[0].revents & POLLIN) != 0) return true;
    if ((fds[1].revents & POLLIN) != 0) accept_connection();
    if ((fds[2].revents & POLLIN) != 0) collect_replies();
    const auto now = std::chrono::steady_clock::now();
    for (std::size_t i = 0; i < ids.size(); ++i) {
      Connection& connection = connections_.at(ids[i]);
      const short events = fds[i + 3].revents;
      bool alive = now < connection.deadline && (events & (POLLHUP | POLLERR | POLLNVAL)) == 0;
      if (alive && (events & POLLOUT) != 0) alive = send_reply(connection);
      if (alive && (events & POLLIN) != 0) alive = read_request(ids[i], connection, handle);
      if (!alive) drop(ids[i]);
    }
    if (replies_->interrupted.exchange(false) || now >= end) return false;
  }
}

}  // namespace calib
