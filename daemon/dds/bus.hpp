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

/// calibd's place on DDS: one participant, the writers that live as long as it does, and the windows opened
/// on demand. Every call fails with `dds_failed` and Cyclone's own words when Cyclone does.
class Bus {
 public:
  /// Cyclone's configuration is made here and nowhere else: CYCLONEDDS_URI is not read. `interface` is a
  /// network interface's name or address, or `auto`. Fails with `bad_interface` or `dds_failed`; one Bus per
  /// domain and program. Larger samples than `max_sample_bytes` (serialised) never reach a reader. What Cyclone has to
  /// say of the network goes to `log` (from any thread) or else to standard error, a few lines a minute, the rest
  /// counted.
  [[nodiscard]] static Result<Bus> open(std::uint32_t domain, std::string_view interface,
                                        std::uint32_t max_sample_bytes = 16 << 20, LogLimit::Write log = {});

  [[nodiscard]] Result<SamplingWindow> open_window(const PairTopics& topics);
  /// Who else publishes what.
  [[nodiscard]] Result<std::vector<RemoteWriter>> remote_writers() const;
  /// Ends the `wait` that is going on in another thread, or else the next one. Not for signal handlers.
  void interrupt();

  /// `rt/diagnostics`; to be sent once a second. Tells also what was counted of Cyclone's log.
  [[nodiscard]] Result<void> publish_diagnostics(const Status& status, WallTime now);
  /// `rt/calibd/tf_static_proposed`: all that stand, since a late reader gets the last message only.
  [[nodiscard]] Result<void> publish_proposed(std::span<const ProposedExtrinsic> proposed, WallTime now);
  /// `rt/calibd/drift_alert`; late readers get the last 32.
  [[nodiscard]] Result<void> publish_alert(const DriftAlert& alert);

 private:
  Bus() = default;

  struct EndLog {
    void operator()(LogLimit* log) const;
  };
  std::unique_ptr<LogLimit, EndLog> log_;  // outlives the entities, which still talk as they go
  Entity domain_, participant_, interrupt_;
  Endpoint diagnostics_, proposed_, alerts_;
};

}  // namespace calib
