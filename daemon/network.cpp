#include "network.hpp"

namespace calib {
namespace {

class DdsWindow final : public SampleSource {
 public:
  explicit DdsWindow(SamplingWindow window) : window_(std::move(window)) {}
  Result<std::vector<Sample>> wait(std::chrono::nanoseconds timeout) override { return window_.wait(timeout); }

 private:
  SamplingWindow window_;
};

class DdsNetwork final : public Network {
 public:
  explicit DdsNetwork(Bus bus) : bus_(std::move(bus)) {}

  Result<std::unique_ptr<SampleSource>> open_window(const PairTopics& topics) override {
    return bus_.open_window(topics).map([](SamplingWindow&& window) -> std::unique_ptr<SampleSource> {
      return std::make_unique<DdsWindow>(std::move(window));
    });
  }
  Result<std::vector<RemoteWriter>> remote_writers() const override { return bus_.remote_writers(); }
  void interrupt() override { bus_.interrupt(); }
  Result<void> publish_diagnostics(const Status& status, WallTime now) override {
    return bus_.publish_diagnostics(status, now);
  }
  Result<void> publish_proposed(std::span<const ProposedExtrinsic> proposed, WallTime now) override {
    return bus_.publish_proposed(proposed, now);
  }
  Result<void> publish_alert(const DriftAlert& alert) override { return bus_.publish_alert(alert); }

 private:
  Bus bus_;
};

}  // namespace

std::unique_ptr<Network> make_network(Bus bus) { return std::make_unique<DdsNetwork>(std::move(bus)); }

}  // namespace calib
