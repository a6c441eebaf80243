#include "clock.hpp"

#include <time.h>

namespace calib {
namespace {

std::chrono::nanoseconds read_clock(clockid_t clock) {
  timespec time{};
  clock_gettime(clock, &time);
  return std::chrono::seconds(time.tv_sec) + std::chrono::nanoseconds(time.tv_nsec);
}

}  // namespace

Moment system_clock() { return {read_clock(CLOCK_REALTIME), read_clock(CLOCK_BOOTTIME)}; }

}  // namespace calib
