#pragma once

#include <algorithm>
#include <atomic>
#include <cstddef>
#include <exception>
#include <thread>
#include <vector>

namespace calib::eval {

/// Calls `work(0)` .. `work(count - 1)`, each once, on `threads` threads; returns when all are done. In which order is
/// not said, so that `work` keeps what it finds under its own number. Throws what one of them throws, such as
/// std::bad_alloc, and leaves the others out.
template <typename Work>
void parallel_for(std::size_t count, int threads, const Work& work) {
  std::atomic<std::size_t> next = 0;
  std::atomic_flag failed;
  std::exception_ptr thrown;
  const auto take_turns = [&] {
    try {
      for (std::size_t i = next++; i < count; i = next++) work(i);
    } catch (...) {
      next = count;
      if (!failed.test_and_set()) thrown = std::current_exception();
    }
  };
  {
    std::vector<std::jthread> others;
    const std::size_t useful =
        std::min(static_cast<std::size_t>(std::max(threads, 1)), std::max<std::size_t>(count, 1));
    for (std::size_t i = 1; i < useful; ++i) others.emplace_back(take_turns);
    take_turns();
  }
  if (thrown) std::rethrow_exception(thrown);
}

}  // namespace calib::eval
