#include "calib/cloud_layout.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstring>
#include <vector>

namespace calib {
namespace {

using Scalar = CloudLayout::Scalar;

/// Layouts that are common. A multiple of the right number of columns explains the numbers equally well.
constexpr CloudLayout candidates[] = {
    {Scalar::float32, 3}, {Scalar::float32, 4}, {Scalar::float32, 5}, {Scalar::float32, 6}, {Scalar::float32, 7},
    {Scalar::float32, 8}, {Scalar::float64, 3}, {Scalar::float64, 4}, {Scalar::float64, 5}, {Scalar::float64, 6}};
constexpr double clearly_better_bits = 0.3;
/// For a multiple of the right number of columns, which explains interleaved rings or returns a little better.
constexpr double clearly_better_multiple_bits = 0.5;
constexpr std::uint64_t fewest_numbers = 1000, sampled_numbers = 16384, sampled_points = 4096;

double number_at(std::string_view bytes, Scalar scalar, std::uint64_t index) {
  if (scalar == Scalar::float32) {
    float value;
    std::memcpy(&value, bytes.data() + index * sizeof value, sizeof value);
    return value;
  }
  double value;
  std::memcpy(&value, bytes.data() + index * sizeof value, sizeof value);
  return value;
}

bool holds_whole_points(std::string_view bytes, const CloudLayout& layout) {
  return bytes.size() % layout.point_bytes() == 0;
}

std::optional<std::string> objection(std::string_view bytes, const CloudLayout& layout) {
  const std::uint64_t points = bytes.size() / layout.point_bytes();
  const std::uint64_t step = sampling_step(points, sampled_points, {});
  MeasurableCount count;
  for (std::uint64_t i = 0; i < points; i += step) {
    const auto at = [&](std::uint64_t axis) { return number_at(bytes, layout.scalar, i * layout.columns + axis); };
    count.add(at(0), at(1), at(2));
  }
  return count.objection();
}

constexpr int least_half_octave = -20, most_half_octave = 20, bins = 2 * (most_half_octave - least_half_octave + 1) + 1;

/// Sign and magnitude of a finite number.
std::size_t bin_of(double value) {
  if (value == 0) return bins - 1;
  int exponent = 0;
  const double mantissa = std::frexp(std::abs(value), &exponent);
  const int half_octave =
      std::clamp(2 * exponent + (mantissa < 0.70710678 ? 0 : 1), least_half_octave, most_half_octave);
  const auto step = static_cast<std::size_t>(half_octave - least_half_octave);
  return 2 * step + (value < 0 ? 1 : 0);
}

/// Whether a number is part of what drivers write in place of a point: not finite, or the third zero in a row or more.
/// Such points may alternate with others, so that twice the columns would seem to fit.
bool is_no_return(std::string_view bytes, Scalar scalar, std::uint64_t index) {
  const double value = number_at(bytes, scalar, index);
  if (value != 0) return !std::isfinite(value);
  const std::uint64_t numbers = bytes.size() / (scalar == Scalar::float32 ? 4 : 8);
  std::uint64_t first = index, last = index;
  while (first > 0 && index - first < 2 && number_at(bytes, scalar, first - 1) == 0) --first;
  while (last + 1 < numbers && last - index < 2 && number_at(bytes, scalar, last + 1) == 0) ++last;
  return last - first >= 2;
}

/// Of a number given its column, with Miller's correction for the finite sample.
double entropy_bits(std::string_view bytes, const CloudLayout& layout) {
  const std::uint64_t numbers = bytes.size() / layout.scalar_bytes();
  std::vector<std::array<std::uint32_t, bins>> counts(layout.columns);
  // A step that shares no factor with any number of columns, the true one among them.
  constexpr std::uint64_t all_columns = 720'720;  // least common multiple of 1 .. 16
  const bool all = numbers < 17 * sampled_numbers;
  const std::uint64_t step = all ? 1 : sampling_step(numbers, sampled_numbers, {all_columns});
  for (std::uint64_t i = 0; i < numbers; i += step)
    if (!is_no_return(bytes, layout.scalar, i))
      ++counts[i % layout.columns][bin_of(number_at(bytes, layout.scalar, i))];
  double bits = 0;
  std::uint64_t total = 0;
  for (const auto& column : counts) {
    std::uint64_t in_column = 0, occupied = 0;
    for (const std::uint32_t count : column) in_column += count, occupied += count > 0;
    if (in_column == 0) continue;
    for (const std::uint32_t count : column)
      if (count > 0) bits -= count * std::log2(static_cast<double>(count) / static_cast<double>(in_column));
    bits += static_cast<double>(occupied - 1) / (2 * std::log(2.0));
    total += in_column;
  }
  return total == 0 ? 0 : bits / static_cast<double>(total);
}

/// The layout that explains `bytes` best, and how well; the fewest columns among equals.
struct Fit {
  CloudLayout layout;
  double bits = 0;
};
std::optional<Fit> best_fit(std::string_view bytes) {
  std::optional<Fit> best;
  if (bytes.size() / sizeof(double) < fewest_numbers) return best;
  // However they are grouped: the halves of 64-bit numbers are nothing that a LiDAR measures.
  const Scalar scalar = objection(bytes, {Scalar::float32, 3}) ? Scalar::float64 : Scalar::float32;
  for (const CloudLayout& layout : candidates) {
    if (layout.scalar != scalar || !holds_whole_points(bytes, layout) || objection(bytes, layout)) continue;
    const double bits = entropy_bits(bytes, layout);
    const bool multiple = best && layout.columns % best->layout.columns == 0;
    if (!best || bits < best->bits - (multiple ? clearly_better_multiple_bits : 0)) best = Fit{layout, bits};
  }
  return best;
}

/// The first column behind the reflectance that holds small whole numbers only, of several kinds; from 1.
std::optional<std::size_t> ring_column(std::string_view bytes, const CloudLayout& layout) {
  constexpr double most_rings = 256;
  const std::uint64_t points = bytes.size() / layout.point_bytes();
  const std::uint64_t step = sampling_step(points, sampled_points, {});
  for (std::size_t column = 4; column < layout.columns; ++column) {
    double most = 0;
    bool whole = true;
    for (std::uint64_t i = 0; whole && i < points; i += step) {
      const double value = number_at(bytes, layout.scalar, i * layout.columns + column);
      whole = value >= 0 && value < most_rings && value == std::floor(value);
      most = std::max(most, value);
    }
    if (whole && most > 0) return column + 1;
  }
  return std::nullopt;
}

std::string words(const CloudLayout& layout) {
  return fmt::format("{} floats of {} bits a point ({})", layout.columns, 8 * layout.scalar_bytes(), to_string(layout));
}

std::string description(std::string_view bytes, const CloudLayout& layout) {
  const auto ring = ring_column(bytes, layout);
  return words(layout) + (ring ? fmt::format(", of which number {} counts rings", *ring) : "");
}

}  // namespace

std::string to_string(const CloudLayout& layout) {
  return fmt::format("float{}x{}", 8 * layout.scalar_bytes(), layout.columns);
}

Result<CloudLayout> parse_cloud_layout(std::string_view word) {
  for (const Scalar scalar : {Scalar::float32, Scalar::float64})
    for (std::size_t columns = CloudLayout::fewest_columns; columns <= CloudLayout::most_columns; ++columns)
      if (const CloudLayout layout{scalar, columns}; word == to_string(layout)) return layout;
  return fail(ErrorCode::cloud_layout, "'" + escape_control(word.substr(0, 32)) +
                                           "' is no layout of a cloud; write float32x4 for four 32-bit floats a point "
                                           "(float32 or float64, 3 to 16 a point: x, y, z, reflectance, others)");
}

Result<void> check_cloud_layout(std::string_view bytes, const CloudLayout& layout, LayoutIs known) {
  const bool whole = holds_whole_points(bytes, layout);
  const auto odd = whole ? objection(bytes, layout) : std::nullopt;
  if (whole && !odd && known == LayoutIs::stated) return {};
  const auto best = best_fit(bytes);
  const bool another = best && best->layout != layout;
  if (whole && !odd) {
    const bool multiple = another && best->layout.columns % layout.columns == 0;
    const double margin = multiple ? clearly_better_multiple_bits : clearly_better_bits;
    if (!another || entropy_bits(bytes, layout) < best->bits + margin) return {};
  }
  return fail(whole || another ? ErrorCode::cloud_layout : ErrorCode::cloud_unreadable,
              (whole ? "does not look like points of " : "does not hold whole points of ") + words(layout) +
                  (odd ? ": " + *odd : "") + (another ? "; it looks like " + description(bytes, best->layout) : ""));
}

bool is_measurable(double coordinate) {
  const double size = std::abs(coordinate);
  return size == 0 || !std::isfinite(size) || (size >= 1e-17 && size <= 1e7);
}

void MeasurableCount::add(double x, double y, double z) {
  ++points_;
  for (const double coordinate : {x, y, z}) {
    if (is_measurable(coordinate)) continue;
    if (++refused_ == 1) example_ = coordinate;
    return;
  }
}

std::optional<std::string> MeasurableCount::objection() const {
  if (refused_ * 5 <= points_) return std::nullopt;
  return fmt::format("{} % of the points have a coordinate that no LiDAR measures, such as {:.3g}",
                     100 * refused_ / points_, example_);
}

std::uint64_t sampling_step(std::uint64_t count, std::uint64_t wanted, std::initializer_list<std::uint64_t> periods) {
  std::uint64_t step = count / std::max<std::uint64_t>(wanted, 1);
  if (step <= 1) return 1;
  const auto is_prime = [](std::uint64_t n) {
    for (std::uint64_t d = 2; d * d <= n; ++d)
      if (n % d == 0) return false;
    return true;
  };
  const auto divides_one = [&](std::uint64_t n) {
    return std::ranges::any_of(periods, [n](std::uint64_t period) { return period > 0 && period % n == 0; });
  };
  while (!is_prime(step) || divides_one(step)) ++step;
  return step;
}

}  // namespace calib
