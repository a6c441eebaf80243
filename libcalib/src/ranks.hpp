#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <cstdint>
#include <vector>

namespace calib {

/// Upper limits of `FeatureSet::ranks` classes of values that are not NaN, at least one: class i holds what is above
/// the limit of class i - 1 and not above limits[i]; the last class has none.
using RankLimits = std::vector<float> (*)(std::vector<float> values);

/// Of equally populated classes.
[[nodiscard]] std::vector<float> equal_population_limits(std::vector<float> values);

/// Of classes of equal width from the smallest value to one that only a hundredth of them exceed: single wild values
/// would leave all others in one class.
[[nodiscard]] std::vector<float> equal_width_limits(std::vector<float> values);

/// Finds a value's class: that of the first limit which is not below it.
class RankClassifier {
 public:
  explicit RankClassifier(std::vector<float> limits);
  [[nodiscard]] std::uint8_t operator()(float value) const;

 private:
  // Over the bits of floats, which grow with the number: says where to begin to look.
  static constexpr std::uint32_t table_size = 2048;
  std::vector<float> limits_;
  std::uint32_t first_;
  int shift_ = 0;
  std::array<std::uint8_t, table_size> begin_{};
};

/// The bits of a number that is not NaN, so that they grow with it; 0 and -0 have the same.
[[nodiscard]] inline std::uint32_t ordered_bits(float value) {
  const auto bits = std::bit_cast<std::uint32_t>(value + 0.F);
  return bits >> 31 != 0 ? ~bits : bits | 0x80000000U;
}

inline std::uint8_t RankClassifier::operator()(float value) const {
  if (value <= limits_.front()) return 0;
  const std::uint32_t entry = (ordered_bits(value) - first_) >> shift_;
  std::uint8_t at = begin_[std::min(entry, table_size - 1)];
  while (at < limits_.size() && limits_[at] < value) ++at;
  return at;
}

}  // namespace calib
