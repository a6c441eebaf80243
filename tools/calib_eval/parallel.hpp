#pragma once

#include <algorithm>
#include <atomic>
#include <cstddef>
#include <thread>
#include <vector>

namespace calib::eval {

/// Calls `work(0)` .. `work(count - 1)`, each once, on `threads` threads; returns when all are done. In which order is
/// not said, so that `work` keeps what it finds under its own number.
template <typename Work>
void parallel_for(std::size_t count, int threads, const Work& work) {
  std::atomic<std::size_t> next = 0;
  const auto take_turns = [&] {
    for (std::size_t i = next++; i < count; i = next++) work(i);
  };
  std::vector<std::jthread> others;
  const std::size_t useful = std::min(static_cast<std::size_t>(std::max(threads, 1)), std::max<std::size_t>(count, 1));
  for (std::size_t i = 1; i < useful; ++i) others.emplace_back(take_turns);
  take_turns();
}

}  // namespace calib::eval
