#include "control.hpp"

#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <unistd.h>

#include <atomic>
#include <cstring>
#include <thread>

#include "support/catch.hpp"
#include "support/support.hpp"

using namespace calib;
using namespace std::chrono_literals;
using nlohmann::json;

namespace {

/// A control socket served by a thread of its own that answers each request with itself.
class EchoDaemon {
 public:
  EchoDaemon() : control_(test::require_ok(ControlSocket::open(path()))) {
    server_ = std::thread([this] {
      while (!stop_)
        control_.serve(20ms, -1, [this](ClientRequest request) {
          ++requests_;
          // Answered from another thread, as the daemon's worker does.
          std::thread([request = std::move(request)] {
            request.reply({{"ok", true}, {"echo", request.request}, {"may_change", request.peer.may_change}});
          }).detach();
        });
    });
  }
  ~EchoDaemon() {
    stop_ = true;
    server_.join();
  }
  [[nodiscard]] std::filesystem::path path() const { return folder_.path() / "control.sock"; }
  [[nodiscard]] int requests() const { return requests_; }

 private:
  test::TemporaryFolder folder_;
  ControlSocket control_;
  std::atomic<bool> stop_ = false;
  std::atomic<int> requests_ = 0;
  std::thread server_;
};

class Client {
 public:
  explicit Client(const std::filesystem::path& path) : fd_(socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0)) {
    sockaddr_un address{};
    address.sun_family = AF_UNIX;
    std::strcpy(address.sun_path, path.c_str());
    REQUIRE(connect(fd_, reinterpret_cast<const sockaddr*>(&address), sizeof address) == 0);
  }
  ~Client() { close(fd_); }
  void say(const std::string& text) const {
    for (std::size_t sent = 0; sent < text.size();) {
      const ssize_t count = send(fd_, text.data() + sent, text.size() - sent, MSG_NOSIGNAL);
      if (count <= 0) return;  // the daemon has had enough
      sent += static_cast<std::size_t>(count);
    }
  }
  /// Everything until the daemon closes or a whole line has come.
  [[nodiscard]] std::string hear() const {
    std::string heard;
    char buffer[4096];
    while (heard.find('\n') == std::string::npos) {
      const ssize_t count = read(fd_, buffer, sizeof buffer);
      if (count <= 0) break;
      heard.append(buffer, static_cast<std::size_t>(count));
    }
    return heard;
  }

 private:
  int fd_;
};

}  // namespace

TEST_CASE("a request is answered once, in one line, by whatever thread") {
  const EchoDaemon daemon;
  const Client client(daemon.path());
  client.say("{\"schema\":1,\"req");
  client.say("uest\":\"status\",\"x\":\"\xff\"}\n");  // not UTF-8: refused, not echoed
  CHECK(json::parse(client.hear())["ok"] == false);
  const Client second(daemon.path());
  second.say("{\"schema\":1,\"request\":\"status\"}\n");
  const json reply = json::parse(second.hear());
  CHECK(reply["echo"]["request"] == "status");
  CHECK(reply["may_change"] == true);  // ourselves
  CHECK(second.hear().empty());        // and then the connection is closed
}

TEST_CASE("what is no request is refused and reaches nobody") {
  const EchoDaemon daemon;
  for (const char* text : {"\n", "[]\n", "{}\n", "{\"schema\":2,\"request\":\"status\"}\n",
                           "{\"schema\":1,\"request\":7}\n", "{\"schema\":1\n", "\"status\"\n"}) {
    const Client client(daemon.path());
    client.say(text);
    CHECK(json::parse(client.hear())["code"] == "bad_request");
  }
  const Client endless(daemon.path());
  endless.say(std::string(80 * 1024, ' '));
  CHECK(json::parse(endless.hear())["code"] == "bad_request");
  CHECK(daemon.requests() == 0);
}

TEST_CASE("silent clients do not keep others from being heard") {
  const EchoDaemon daemon;
  std::vector<std::unique_ptr<Client>> silent;
  for (int i = 0; i < 15; ++i) silent.push_back(std::make_unique<Client>(daemon.path()));
  const Client client(daemon.path());
  client.say("{\"schema\":1,\"request\":\"status\"}\n");
  CHECK(json::parse(client.hear())["ok"] == true);
}

TEST_CASE("the socket is the daemon's own: others may not open it, and a second daemon is refused") {
  const EchoDaemon daemon;
  struct stat info {};
  REQUIRE(stat(daemon.path().c_str(), &info) == 0);
  CHECK((info.st_mode & 0777) == 0660);
  const auto second = ControlSocket::open(daemon.path());
  REQUIRE_FALSE(second);
  CHECK(second.error().code == "control_socket");
  const Client client(daemon.path());
  client.say("{\"schema\":1,\"request\":\"status\"}\n");
  CHECK(json::parse(client.hear())["ok"] == true);
}

TEST_CASE("a socket that a dead daemon left is replaced") {
  const test::TemporaryFolder folder;
  const auto path = folder.path() / "control.sock";
  const int fd = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  std::strcpy(address.sun_path, path.c_str());
  REQUIRE(bind(fd, reinterpret_cast<const sockaddr*>(&address), sizeof address) == 0);
  close(fd);
  CHECK(ControlSocket::open(path));
}

TEST_CASE("an interrupt ends the serving in progress, or else the next one, and no more") {
  const test::TemporaryFolder folder;
  auto control = test::require_ok(ControlSocket::open(folder.path() / "control.sock"));
  const auto served = [&](std::chrono::milliseconds timeout) {
    const auto begin = std::chrono::steady_clock::now();
    CHECK_FALSE(control.serve(timeout, -1, [](const ClientRequest&) {}));
    return std::chrono::steady_clock::now() - begin;
  };
  std::thread other([&] {
    std::this_thread::sleep_for(100ms);
    control.interrupt();
  });
  CHECK(served(20s) < 5s);
  other.join();
  control.interrupt();
  control.interrupt();
  CHECK(served(20s) < 5s);
  CHECK(served(200ms) >= 199ms);
}
