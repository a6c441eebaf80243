#pragma once

#include <sys/types.h>

#include <atomic>
#include <chrono>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "calib/result.hpp"

namespace calib {

/// The process at the other end of the control socket, as the kernel names it.
struct Peer {
  uid_t uid = 0;
  pid_t pid = 0;
  /// The user that logged in, which sudo and su do not change, read from /proc when the connection was accepted; none
  /// for a service, or where this process may not look.
  std::optional<uid_t> login{};
  /// root, the daemon's own user, or a member of its group. Anyone who can open the socket may read.
  bool may_change = false;
  /// root, or the daemon's own user.
  bool may_change_keys = false;
  /// Who may change, and the user calib-uplink: the events that it has delivered leave the outbox.
  bool may_acknowledge = false;
};

/// A file that a client has sent along with its request; closed when nobody needs it any more.
struct SentFile {
  int fd = -1;
  explicit SentFile(int descriptor) : fd(descriptor) {}
  SentFile(const SentFile&) = delete;
  SentFile& operator=(const SentFile&) = delete;
  ~SentFile();
};

/// One request of a client. `reply` may be called from any thread, once; when the client has disconnected, it does
/// nothing.
struct ClientRequest {
  nlohmann::json request;
  Peer peer;
  std::function<void(nlohmann::json)> reply;
  /// Set when the client disconnects.
  std::shared_ptr<const std::atomic<bool>> client_gone = std::make_shared<const std::atomic<bool>>(false);
  std::shared_ptr<const SentFile> file{};
};

/// The control socket (proto/control.md): one JSON line in, one JSON line out, on a UNIX stream socket. One thread runs
/// it and never blocks: a slow or silent client costs a file descriptor for ten seconds, at most sixteen at a time.
class ControlSocket {
 public:
  /// Replaces a socket that a dead daemon left. Fails with `control_socket` when a live daemon listens there.
  [[nodiscard]] static Result<ControlSocket> open(const std::filesystem::path& path);
  ControlSocket(ControlSocket&& other) noexcept;
  ControlSocket& operator=(ControlSocket&&) = delete;
  ~ControlSocket();

  /// Serves until `timeout` passed, `interrupt` was called or `other_fd` (-1: none) can be read, and returns whether
  /// the last.
  bool serve(std::chrono::milliseconds timeout, int other_fd, const std::function<void(ClientRequest)>& handle);
  /// Ends a `serve` in another thread, or else the next one.
  void interrupt() const;

 private:
  struct Connection {
    int fd = -1;
    Peer peer;
    std::string received;
    std::string to_send;
    std::shared_ptr<const SentFile> file;
    bool requested = false;
    std::shared_ptr<std::atomic<bool>> gone = std::make_shared<std::atomic<bool>>(false);
    std::chrono::steady_clock::time_point deadline;
  };
  /// Replies of other threads, until the serving thread sends them.
  struct Replies {
    std::mutex mutex;
    std::map<std::uint64_t, std::string> lines;
    int wake_fd = -1;
    std::atomic<bool> interrupted = false;
    void wake() const;
    ~Replies();
  };

  ControlSocket() = default;
  void accept_connection();
  /// False: the connection is over.
  [[nodiscard]] bool read_request(std::uint64_t id, Connection& connection,
                                  const std::function<void(ClientRequest)>& handle);
  [[nodiscard]] static bool send_reply(Connection& connection);
  void collect_replies();
  void drop(std::uint64_t id);

  int listen_fd_ = -1;
  std::filesystem::path path_;
  std::uint64_t next_id_ = 1;
  std::map<std::uint64_t, Connection> connections_;
  std::shared_ptr<Replies> replies_;
};

/// One line of the control socket, without its end. Fails with `bad_request`.
[[nodiscard]] Result<nlohmann::json> parse_request(std::string_view line);

/// The reply that says no: `{"ok":false,"code":…,"message":…}`.
[[nodiscard]] nlohmann::json refusal(std::string_view code, std::string_view message);

}  // namespace calib
