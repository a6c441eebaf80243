#include "dds/bus.hpp"

#include <fmt/format.h>

#include <cstdio>
#include <memory>
#include <mutex>

#include "dds/names.hpp"
#include "dds/reach.hpp"

namespace calib {
namespace {

/// Cyclone's configuration. Multicast is allowed on loopback explicitly: Linux does not set its multicast flag. The
/// size of the receive buffer is a request, which `net.core.rmem_max` limits.
///
/// Memory that the samples of one remote writer may occupy before they are read:
/// - incomplete ones: two (four of a reliable writer) of `max_sample_bytes` each;
/// - complete ones not yet delivered to a reader: 32 of all writers together, then Cyclone stops reading the network;
/// - delivered ones: as many as the reader's history holds;
/// - samples out of order: 16. They are kept for reliable readers only: those of discovery, and for one window that of
///   a topic which was silent.
///
/// A fragment keeps the whole receive buffer in which it arrived, so these buffers are small. Cyclone does not limit
/// the number of participants and writers. The unit's MemoryMax limits the total.
///
/// Multicast finds other participants (SPDP) and carries no samples. A writer whose samples go to two or more other
/// readers sends them to the domain's multicast group, where every participant that joined it receives and drops them,
/// with or without a reader: with 30 MB/s of images and scans, a thousand wake-ups a second and 0.9 % of a core. So
/// calibd's readers ask for unicast, which comes while they exist. This alone does not help: Cyclone also binds a
/// socket to the port of multicast data and joins it to the group of SPDP, which is the same. It is given a port of the
/// domain's range that nobody sends to (RTPS 2.2, 9.6.1.1 uses the offsets 0, 1, 10, 11 and up). One thread receives
/// everything: the second and third would each hold a receive buffer and wait for what hardly comes.
///
/// Peers send to the unicast ports of a participant's index, so that calibd needs one where there are any.
std::string cyclone_configuration(std::string_view interface, std::uint32_t max_sample_bytes, const Reach& reach) {
  const std::string choice = interface == "auto" ? R"(autodetermine="true")"
                                                 : fmt::format(R"(name="{}" multicast="{}")", interface,
                                                               interface == "lo" ? "true" : "default");
  std::string discovery;
  if (!reach.multicast || !reach.peers.empty()) discovery += "<ParticipantIndex>auto</ParticipantIndex>";
  std::string peers;
  for (const std::string& peer : reach.peers) peers += fmt::format(R"(<Peer Address="{}"/>)", peer);
  if (!peers.empty()) discovery += "<Peers>" + peers + "</Peers>";
  return fmt::format(
      "<CycloneDDS><Domain><General><Interfaces><NetworkInterface {}/></Interfaces>"
      "<AllowMulticast>{}</AllowMulticast></General>"
      "<Discovery>{}<Ports><MulticastDataOffset>2</MulticastDataOffset></Ports></Discovery>"
      "<Internal><MultipleReceiveThreads>false</MultipleReceiveThreads>"
      R"(<SocketReceiveBufferSize min="default" max="10MB"/><MaxSampleSize>{}B</MaxSampleSize>)"
      "<DefragUnreliableMaxSamples>2</DefragUnreliableMaxSamples>"
      "<DefragReliableMaxSamples>4</DefragReliableMaxSamples>"
      "<DeliveryQueueMaxSamples>32</DeliveryQueueMaxSamples>"
      "<PrimaryReorderMaxSamples>16</PrimaryReorderMaxSamples>"
      "<SecondaryReorderMaxSamples>16</SecondaryReorderMaxSamples></Internal>"
      "<Sizing><ReceiveBufferSize>256KiB</ReceiveBufferSize></Sizing>"
      "</Domain></CycloneDDS>",
      choice, reach.multicast ? "spdp" : "false", discovery, max_sample_bytes);
}

int syslog_priority(std::uint32_t category) {
  return (category & (DDS_LC_FATAL | DDS_LC_ERROR)) != 0 ? 3 : (category & DDS_LC_WARNING) != 0 ? 4 : 6;
}

void hear_cyclone(void* log, const dds_log_data_t* data) {
  static_cast<LogLimit*>(log)->log(syslog_priority(data->priority), {data->message, data->size});
}

constexpr int syslog_error = 3;

/// From whatever thread.
class LastLine {
 public:
  void set(const std::string& line) {
    const std::lock_guard lock(mutex_);
    line_ = line;
  }
  [[nodiscard]] std::string get() {
    const std::lock_guard lock(mutex_);
    return line_;
  }

 private:
  std::mutex mutex_;
  std::string line_;
};

void to_standard_error(int, const std::string& line) { std::fprintf(stderr, "%s\n", escape_control(line).c_str()); }

}  // namespace

void Bus::EndLog::operator()(LogLimit* log) const {
  dds_set_log_sink(nullptr, nullptr);
  delete log;
}

Result<Bus> Bus::open(std::uint32_t domain, std::string_view interface, std::uint32_t max_sample_bytes,
                      LogLimit::Write log, const Reach& reach) {
  for (const std::string& peer : reach.peers)
    if (!is_peer_address(peer))
      return fail(ErrorCode::bad_interface, "a peer is a host name or an address, like 192.168.1.7");
  if (!is_interface_name(interface))
    return fail(ErrorCode::bad_interface, "a network interface is named like lo, eth0 or auto");
  Bus bus;
  const auto last_error = std::make_shared<LastLine>();
  bus.log_.reset(new LogLimit("Cyclone DDS", &std::chrono::steady_clock::now,
                              [last_error, write = log ? std::move(log) : LogLimit::Write(&to_standard_error)](
                                  int priority, const std::string& line) {
                                if (priority <= syslog_error) last_error->set(line);
                                write(priority, line);
                              }));
  dds_set_log_sink(&hear_cyclone, bus.log_.get());
  const auto opened = [&](Result<Entity> entity, Entity& into) -> Result<void> {
    if (!entity) return propagate(entity);
    into = std::move(*entity);
    return {};
  };
  auto result = opened(own(dds_create_domain(domain, cyclone_configuration(interface, max_sample_bytes, reach).c_str()),
                           fmt::format("DDS domain {} on interface {}", domain, interface)),
                       bus.domain_);
  if (result) result = opened(own(dds_create_participant(domain, nullptr, nullptr), "participant"), bus.participant_);
  if (result)
    result = opened(own(dds_create_guardcondition(bus.participant_.get()), "guard condition"), bus.interrupt_);
  if (!result) {
    // Cyclone's code says only that it failed; what the system says comes first, then Cyclone's own words.
    if (auto obstacle = obstacle_to_domain(domain, interface, reach.multicast))
      return tl::unexpected(std::move(*obstacle));
    if (const std::string words = last_error->get(); !words.empty()) result.error().context += "; " + words;
    return propagate(result);
  }

  const auto write = [&](const MessageType& type, std::string_view topic, const QosProfile& profile,
                         Endpoint& into) -> Result<void> {
    auto writer = make_writer(bus.participant_.get(), type, topic, profile);
    if (!writer) return propagate(writer);
    into = std::move(*writer);
    return {};
  };
  result = write(diagnostics_type, "/diagnostics", {.reliable = true, .durable = false, .depth = 10}, bus.diagnostics_);
  if (result)
    result = write(transforms_type, "/calibd/tf_static_proposed", {.reliable = true, .durable = true, .depth = 1},
                   bus.proposed_);
  if (result)
    result =
        write(drift_alert_type, "/calibd/drift_alert", {.reliable = true, .durable = true, .depth = 32}, bus.alerts_);
  if (!result) return propagate(result);
  return bus;
}

Result<SamplingWindow> Bus::open_window(const PairTopics& topics) {
  return SamplingWindow::open(participant_.get(), interrupt_.get(), topics, silent_topics_);
}

Result<std::vector<RemoteWriter>> Bus::remote_writers() const { return calib::remote_writers(participant_.get()); }

void Bus::interrupt() { dds_set_guardcondition(interrupt_.get(), true); }

Result<void> Bus::publish_diagnostics(const Status& status, WallTime now) {
  log_->report_if_due();
  return check(dds_write(diagnostics_.endpoint.get(), diagnostics_message(status, now).get()), "/diagnostics");
}

Result<void> Bus::publish_proposed(std::span<const ProposedExtrinsic> proposed, WallTime now) {
  return check(dds_write(proposed_.endpoint.get(), transforms_message(proposed, now).get()),
               "/calibd/tf_static_proposed");
}

Result<void> Bus::publish_alert(const DriftAlert& alert) {
  return check(dds_write(alerts_.endpoint.get(), drift_alert_message(alert).get()), "/calibd/drift_alert");
}

}  // namespace calib
