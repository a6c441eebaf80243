#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <string>
#include <thread>

#include "dds/entity.hpp"
#include "support/support.hpp"

namespace calib::test {

/// Another program's place on DDS, as far as the wire can tell: Cyclone lets one process join a domain a
/// second time under another number, and then everything goes over the loopback network.
class Peer {
 public:
  explicit Peer(int domain)
      : domain_(require_ok(own(dds_create_domain(number, configuration(domain).c_str()), "peer's domain"))),
        participant_(require_ok(own(dds_create_participant(number, nullptr, nullptr), "peer"))) {}

  [[nodiscard]] dds_entity_t participant() const { return participant_.get(); }

 private:
  static constexpr dds_domainid_t number = 1000;
  static std::string configuration(int domain) {
    return R"(<CycloneDDS><Domain><General><Interfaces><NetworkInterface name="lo" multicast="true"/></Interfaces>)"
           "</General><Discovery><ExternalDomainId>" +
           std::to_string(domain) + "</ExternalDomainId></Discovery></Domain></CycloneDDS>";
  }

  Entity domain_, participant_;
};

/// Asks `condition` until it holds; false when it does not within five seconds.
[[nodiscard]] inline bool eventually(const std::function<bool()>& condition) {
  using namespace std::chrono_literals;
  for (const auto end = std::chrono::steady_clock::now() + 5s; std::chrono::steady_clock::now() < end;) {
    if (condition()) return true;
    std::this_thread::sleep_for(5ms);
  }
  return false;
}

[[nodiscard]] inline std::uint32_t readers_of(const Endpoint& writer) {
  dds_publication_matched_status_t status;
  require_ok(check(dds_get_publication_matched_status(writer.endpoint.get(), &status), "matched"));
  return status.current_count;
}

[[nodiscard]] inline std::uint32_t writers_to(const Endpoint& reader) {
  dds_subscription_matched_status_t status;
  require_ok(check(dds_get_subscription_matched_status(reader.endpoint.get(), &status), "matched"));
  return status.current_count;
}

/// Calls `look` with each sample that `reader` has, and returns how many there were.
template <typename Message>
int take_all(const Endpoint& reader, const std::function<void(const Message&)>& look) {
  void* samples[64] = {};
  dds_sample_info_t infos[64];
  const dds_return_t taken = dds_take(reader.endpoint.get(), samples, infos, 64, 64);
  require_ok(check(taken, "take"));
  for (int i = 0; i < taken; ++i)
    if (infos[i].valid_data) look(*static_cast<const Message*>(samples[i]));
  if (taken > 0) dds_return_loan(reader.endpoint.get(), samples, taken);
  return taken;
}

}  // namespace calib::test
