#pragma once

#include <map>

#include "dds/window.hpp"
#include "support/support.hpp"

namespace calib::test {

inline constexpr QosProfile best_effort{.reliable = false, .durable = false, .depth = 1};
inline constexpr QosProfile reliable{.reliable = true, .durable = false, .depth = 5};

template <typename Message>
void publish(const Endpoint& writer, Message message) {
  const auto raw = message.raw();
  require_ok(check(dds_write(writer.endpoint.get(), &raw), "publish"));
}

/// The first sample of each kind until there are `kinds` of them. A writer knows of its reader before the reader knows
/// of the writer, and loses what it sends in between: so all is sent again, each second for five.
template <typename Send>
std::vector<Sample> received(SamplingWindow& window, std::size_t kinds, Send send) {
  std::map<std::size_t, Sample> samples;
  for (int attempt = 0; attempt < 5 && samples.size() < kinds; ++attempt) {
    send();
    for (int slice = 0; slice < 10 && samples.size() < kinds; ++slice)
      for (Sample& sample : require_ok(window.wait(std::chrono::milliseconds(100))))
        samples.try_emplace(sample.index(), std::move(sample));
  }
  std::vector<Sample> found;
  for (auto& [kind, sample] : samples) found.push_back(std::move(sample));
  return found;
}

template <typename As>
const As* find(const std::vector<Sample>& samples) {
  for (const Sample& sample : samples)
    if (const As* found = std::get_if<As>(&sample)) return found;
  return nullptr;
}

}  // namespace calib::test
