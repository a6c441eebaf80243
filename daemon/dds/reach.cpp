#include "dds/reach.hpp"

#include <arpa/inet.h>
#include <fmt/format.h>
#include <ifaddrs.h>
#include <net/if.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <memory>
#include <string>

namespace calib {
namespace {

struct FreeAddresses {
  void operator()(ifaddrs* list) const { ::freeifaddrs(list); }
};

std::string address_of(const ifaddrs& entry) {
  char text[INET_ADDRSTRLEN] = "";
  ::inet_ntop(AF_INET, &reinterpret_cast<const sockaddr_in*>(entry.ifa_addr)->sin_addr, text, sizeof text);
  return text;
}

std::optional<Error> obstacle_of_interface(std::string_view wanted) {
  if (wanted == "auto") return std::nullopt;
  ifaddrs* first = nullptr;
  if (::getifaddrs(&first) != 0) return std::nullopt;
  const std::unique_ptr<ifaddrs, FreeAddresses> list(first);
  bool exists = false, is_up = false, has_address = false;
  std::string others;
  for (const ifaddrs* entry = first; entry != nullptr; entry = entry->ifa_next) {
    const bool is_ipv4 = entry->ifa_addr != nullptr && entry->ifa_addr->sa_family == AF_INET;
    if (is_ipv4) others += fmt::format("{}{} ({})", others.empty() ? "" : ", ", entry->ifa_name, address_of(*entry));
    if (entry->ifa_name != wanted && !(is_ipv4 && address_of(*entry) == wanted)) continue;
    exists = true;
    is_up = is_up || (entry->ifa_flags & IFF_UP) != 0;
    has_address = has_address || is_ipv4;
  }
  const auto refuse = [&](std::string_view what, std::string_view remedy) {
    return Error{ErrorCode::dds_failed, fmt::format("dds.interface: {}; {}", what, remedy)};
  };
  if (!exists)
    return refuse(fmt::format("there is no network interface {}", wanted),
                  others.empty() ? "no interface here has an IPv4 address" : "there are: " + others);
  if (!is_up) return refuse(fmt::format("{} is down", wanted), fmt::format("`ip link set {} up` starts it", wanted));
  if (!has_address)
    return refuse(fmt::format("{} has no IPv4 address", wanted), "give it one, or name another interface");
  return std::nullopt;
}

/// As Cyclone binds the sockets that it shares with other participants.
std::optional<Error> obstacle_of_port(std::uint32_t domain, int port) {
  const int fd = ::socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0);
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_port = htons(static_cast<std::uint16_t>(port));
  const int yes = 1;
  const bool bound = fd >= 0 && ::setsockopt(fd, SOL_SOCKET, SO_REUSEADDR, &yes, sizeof yes) == 0 &&
                     ::bind(fd, reinterpret_cast<const sockaddr*>(&address), sizeof address) == 0;
  const int why = errno;
  if (fd >= 0) ::close(fd);
  if (bound) return std::nullopt;
  if (why == EADDRINUSE)
    return Error{
        ErrorCode::dds_failed,
        fmt::format("dds.domain: UDP port {0} of domain {1} is in use by a program that does not share it; `ss "
                    "-lunp sport = {0}` shows which; end it, or use another domain",
                    port, domain)};
  const bool denied = why == EACCES || why == EPERM || why == EAFNOSUPPORT;  // the last by RestrictAddressFamilies=
  return Error{
      ErrorCode::dds_failed,
      fmt::format("dds.domain: UDP port {} of domain {} cannot be opened: {}{}", port, domain, std::strerror(why),
                  denied ? "; calibd needs AF_INET sockets: look at RestrictAddressFamilies= and "
                           "SystemCallFilter= of its unit, and at what confines it besides"
                         : "")};
}

}  // namespace

std::optional<Error> obstacle_to_domain(std::uint32_t domain, std::string_view interface, bool by_multicast) {
  if (auto obstacle = obstacle_of_interface(interface)) return obstacle;
  // RTPS 2.2, 9.6.1.1: base 7400, gain 250 a domain. The offsets are those of Cyclone's configuration in bus.cpp:
  // discovery, and what stands for the data. Unicast ports are free ones.
  constexpr int base = 7400, gain = 250;
  if (!by_multicast) return std::nullopt;
  for (const int offset : {0, 2})
    if (auto obstacle = obstacle_of_port(domain, base + gain * static_cast<int>(domain) + offset)) return obstacle;
  return std::nullopt;
}

}  // namespace calib
