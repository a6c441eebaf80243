#pragma once

#include <chrono>
#include <memory>
#include <span>
#include <vector>

#include "dds/bus.hpp"

namespace calib {

/// Readers of a pair's topics, for as long as this lives.
class SampleSource {
 public:
  SampleSource() = default;
  SampleSource(const SampleSource&) = delete;
  SampleSource& operator=(const SampleSource&) = delete;
  virtual ~SampleSource() = default;
  /// As `SamplingWindow::wait`; by the service's clock, too, time passes meanwhile.
  [[nodiscard]] virtual Result<std::vector<Sample>> wait(std::chrono::nanoseconds timeout) = 0;
};

/// What the service needs of DDS, as `Bus` explains it: a test gives it samples of its own. `interrupt` and
/// `publish_diagnostics` are called from another thread than the rest.
class Network {
 public:
  Network() = default;
  Network(const Network&) = delete;
  Network& operator=(const Network&) = delete;
  virtual ~Network() = default;

  [[nodiscard]] virtual Result<std::unique_ptr<SampleSource>> open_window(const PairTopics& topics) = 0;
  [[nodiscard]] virtual Result<std::vector<RemoteWriter>> remote_writers() const = 0;
  virtual void interrupt() = 0;
  [[nodiscard]] virtual Result<void> publish_diagnostics(const Status& status, WallTime now) = 0;
  [[nodiscard]] virtual Result<void> publish_proposed(std::span<const ProposedExtrinsic> proposed, WallTime now) = 0;
  [[nodiscard]] virtual Result<void> publish_alert(const DriftAlert& alert) = 0;
};

[[nodiscard]] std::unique_ptr<Network> make_network(Bus bus);

}  // namespace calib
