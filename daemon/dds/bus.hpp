#pragma once

#include <functional>
#include <memory>
#include <span>
#include <string>
#include <string_view>

#include "dds/discovery.hpp"
#include "dds/entity.hpp"
#include "dds/log_limit.hpp"
#include "dds/messages.hpp"
#include "dds/window.hpp"

namespace calib {

/// How participants find each other where the network lets no multicast through: each tells its presence to the
/// addresses of `peers`, which have to do likewise.
struct Reach {
  bool multicast = true;
  std::vector<std::string> peers = {};  // host names or addresses
};

/// calibd's DDS participant with its writers, which live as long as the bus, and the sampling windows that it opens on
/// demand. Each call fails with `dds_failed` and Cyclone's message when Cyclone fails.
class Bus {
 public:
  /// At most one Bus per domain and process. `interface` is the name or address of a network interface, or `auto`.
  /// Samples larger than `max_sample_bytes` (serialised) never reach a reader. Cyclone's log goes to `log` (called from
  /// any thread) or else to standard error, limited by `LogLimit`. Cyclone's configuration comes from here alone:
  /// CYCLONEDDS_URI is not read. Fails with `bad_interface` (also for a peer) or `dds_failed`.
  [[nodiscard]] static Result<Bus> open(std::uint32_t domain, std::string_view interface,
                                        std::uint32_t max_sample_bytes = 16 << 20, LogLimit::Write log = {},
                                        const Reach& reach = {});

  [[nodiscard]] Result<SamplingWindow> open_window(const PairTopics& topics);
  /// What other programs publish.
  [[nodiscard]] Result<std::vector<RemoteWriter>> remote_writers() const;
  /// Ends a `SamplingWindow::wait` in another thread, or else the next one. Not for signal handlers.
  void interrupt();

  /// Publishes `rt/diagnostics`; to be called once a second. Also reports the suppressed lines of Cyclone's log.
  [[nodiscard]] Result<void> publish_diagnostics(const Status& status, WallTime now);
  /// Publishes `rt/calibd/tf_static_proposed`. `proposed` holds all current ones: a late reader gets the last message
  /// only.
  [[nodiscard]] Result<void> publish_proposed(std::span<const ProposedExtrinsic> proposed, WallTime now);
  /// Publishes `rt/calibd/drift_alert`. Late readers get the last 32.
  [[nodiscard]] Result<void> publish_alert(const DriftAlert& alert);

 private:
  Bus() = default;

  struct EndLog {
    void operator()(LogLimit* log) const;
  };
  std::unique_ptr<LogLimit, EndLog> log_;  // outlives the entities, which log while they are deleted
  Entity domain_, participant_, interrupt_;
  Endpoint diagnostics_, proposed_, alerts_;
  std::shared_ptr<SamplingWindow::Topics> silent_topics_ = std::make_shared<SamplingWindow::Topics>();
};

}  // namespace calib
