#include "dds/reach.hpp"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cstdlib>

#include "dds/bus.hpp"
#include "support/catch.hpp"
#include "support/support.hpp"

using namespace calib;

namespace {

std::uint32_t domain() { return static_cast<std::uint32_t>(std::atoi(std::getenv("CALIBD_TEST_DOMAIN"))); }

/// A program that has a port of the domain to itself.
class Selfish {
 public:
  explicit Selfish(int port) : fd_(::socket(AF_INET, SOCK_DGRAM, 0)) {
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_port = htons(static_cast<std::uint16_t>(port));
    REQUIRE(::bind(fd_, reinterpret_cast<const sockaddr*>(&address), sizeof address) == 0);
  }
  ~Selfish() { ::close(fd_); }

 private:
  int fd_;
};

}  // namespace

TEST_CASE("an interface that does not exist is named, with those that do") {
  const auto obstacle = obstacle_to_domain(domain(), "nosuch0", true);
  REQUIRE(obstacle);
  CHECK(obstacle->code == ErrorCode::dds_failed);
  CHECK_THAT(obstacle->context,
             Catch::Matchers::StartsWith("dds.interface: there is no network interface nosuch0; there are: ") &&
                 Catch::Matchers::Contains("lo (127.0.0.1)"));
  CHECK(obstacle_to_domain(domain(), "10.254.254.254", true));
  CHECK_FALSE(obstacle_to_domain(domain(), "lo", true));
  CHECK_FALSE(obstacle_to_domain(domain(), "127.0.0.1", true));
  CHECK_FALSE(obstacle_to_domain(domain(), "auto", true));
}

TEST_CASE("a port that another program does not share is named, and a calibd that runs is no obstacle") {
  const int port = 7400 + 250 * static_cast<int>(domain());
  {
    const auto bus = Bus::open(domain(), "lo");
    REQUIRE(bus);
    CHECK_FALSE(obstacle_to_domain(domain(), "lo", true));
  }
  const Selfish other(port);
  const auto obstacle = obstacle_to_domain(domain(), "lo", true);
  REQUIRE(obstacle);
  CHECK_THAT(obstacle->context,
             Catch::Matchers::Contains("UDP port " + std::to_string(port)) && Catch::Matchers::Contains("ss -lunp"));
  CHECK_FALSE(obstacle_to_domain(domain(), "lo", false));
}

TEST_CASE("a bus that cannot be opened says why") {
  const auto nowhere = Bus::open(domain(), "nosuch0", 16 << 20, [](int, const std::string&) {});
  REQUIRE_FALSE(nowhere);
  CHECK_THAT(nowhere.error().context, Catch::Matchers::Contains("there is no network interface nosuch0"));
  const Selfish other(7400 + 250 * static_cast<int>(domain()));
  const auto taken = Bus::open(domain(), "lo", 16 << 20, [](int, const std::string&) {});
  REQUIRE_FALSE(taken);
  CHECK_THAT(taken.error().context, Catch::Matchers::Contains("in use by a program that does not share it"));
}
