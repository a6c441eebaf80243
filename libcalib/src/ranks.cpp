#include "ranks.hpp"

#include <cstddef>
#include <numeric>
#include <utility>

#include "calib/features.hpp"

namespace calib {
namespace {

constexpr int ranks = FeatureSet::ranks;

float from_ordered(std::uint32_t bits) { return std::bit_cast<float>(bits >> 31 != 0 ? bits & 0x7FFFFFFFU : ~bits); }

/// By the digits of their bits, which takes a fifth of the time of std::sort. A frame has some 260 000 values to sort.
void sort(std::vector<float>& values) {
  constexpr int digits = 3, digit_bits = 11;
  constexpr std::size_t digit_values = 1 << digit_bits;
  std::vector<std::uint32_t> from(values.size()), to(values.size());
  std::array<std::array<std::uint32_t, digit_values>, digits> places{};
  const auto digit = [](std::uint32_t bits, int i) { return bits >> (i * digit_bits) & (digit_values - 1); };
  for (std::size_t i = 0; i < values.size(); ++i) {
    from[i] = ordered_bits(values[i]);
    for (int k = 0; k < digits; ++k) ++places[k][digit(from[i], k)];
  }
  for (int k = 0; k < digits; ++k) {
    std::exclusive_scan(places[k].begin(), places[k].end(), places[k].begin(), 0U);
    for (const std::uint32_t bits : from) to[places[k][digit(bits, k)]++] = bits;
    from.swap(to);
  }
  std::ranges::transform(from, values.begin(), from_ordered);
}

}  // namespace

std::vector<float> equal_population_limits(std::vector<float> values) {
  sort(values);
  std::vector<float> limits(ranks - 1);
  for (std::size_t i = 0; i < limits.size(); ++i) limits[i] = values[(i + 1) * values.size() / ranks];
  return limits;
}

std::vector<float> equal_width_limits(std::vector<float> values) {
  sort(values);
  const float least = values.front(), most = values[(values.size() - 1) * 99 / 100];
  std::vector<float> limits(ranks - 1);
  for (std::size_t i = 0; i < limits.size(); ++i)
    limits[i] = least + (most - least) * static_cast<float>(i + 1) / static_cast<float>(ranks);
  return limits;
}

RankClassifier::RankClassifier(std::vector<float> limits)
    : limits_(std::move(limits)), first_(ordered_bits(limits_.front())) {
  const std::uint32_t span = ordered_bits(limits_.back()) - first_;
  while (span >> shift_ >= table_size) ++shift_;
  std::uint8_t at = 0;
  for (std::size_t entry = 0; entry < table_size; ++entry) {
    while (at < limits_.size() && (ordered_bits(limits_[at]) - first_) >> shift_ < entry) ++at;
    begin_[entry] = at;
  }
}

}  // namespace calib
