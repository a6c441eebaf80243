#pragma once

#include <cmath>
#include <cstdint>

namespace calib::vehicle {

/// 64 well mixed bits of `x` (the finaliser of SplitMix64).
[[nodiscard]] constexpr std::uint64_t mix(std::uint64_t x) {
  x += 0x9e3779b97f4a7c15U;
  x = (x ^ (x >> 30)) * 0xbf58476d1ce4e5b9U;
  x = (x ^ (x >> 27)) * 0x94d049bb133111ebU;
  return x ^ (x >> 31);
}

/// A key that depends on every one of its parts and on their order.
template <typename... Parts>
[[nodiscard]] constexpr std::uint64_t mix(std::uint64_t first, std::uint64_t second, Parts... rest) {
  const std::uint64_t both = mix(mix(first) ^ second);
  if constexpr (sizeof...(rest) == 0)
    return both;
  else
    return mix(both, static_cast<std::uint64_t>(rest)...);
}

/// Uniform in [0, 1) from the upper bits of `bits`.
[[nodiscard]] constexpr float unit(std::uint64_t bits) { return static_cast<float>(bits >> 40) * 0x1p-24f; }

/// A stream of random numbers that depends on its key only: the same world comes out whichever part is made
/// first. (The distributions of <random> differ between standard libraries.)
class Random {
 public:
  explicit Random(std::uint64_t key) : key_(key) {}

  std::uint64_t bits() { return mix(key_, count_++); }
  float uniform(float low, float high) { return low + (high - low) * unit(bits()); }
  bool chance(float probability) { return unit(bits()) < probability; }
  int below(int n) { return static_cast<int>(bits() % static_cast<std::uint64_t>(n)); }
  float gaussian() {
    const float radius = std::sqrt(-2.f * std::log(1.f - unit(bits())));
    return radius * std::cos(6.2831853f * unit(bits()));
  }

 private:
  std::uint64_t key_;
  std::uint64_t count_ = 0;
};

}  // namespace calib::vehicle
