#pragma once

#include "network.hpp"

namespace calib::test {

/// A network on which nothing comes, and into which everything is said in vain.
class QuietNetwork : public Network {
 public:
  Result<std::unique_ptr<SampleSource>> open_window(const PairTopics&) override {
    return fail("dds_failed", "there is no network");
  }
  Result<std::vector<RemoteWriter>> remote_writers() const override { return std::vector<RemoteWriter>{}; }
  void interrupt() override {}
  Result<void> publish_diagnostics(const Status&, WallTime) override { return {}; }
  Result<void> publish_proposed(std::span<const ProposedExtrinsic>, WallTime) override { return {}; }
  Result<void> publish_alert(const DriftAlert&) override { return {}; }
};

}  // namespace calib::test
