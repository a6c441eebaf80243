#pragma once

#include <array>
#include <cstdint>
#include <initializer_list>
#include <optional>
#include <string>
#include <string_view>

#include "calib/result.hpp"

namespace calib {

/// How the numbers of a cloud lie in a file that does not say it itself (`.bin`): x, y, z, then reflectance if there is
/// a fourth column; further columns (ring, time) are not read.
struct CloudLayout {
  enum class Scalar { float32, float64 };
  Scalar scalar = Scalar::float32;
  std::size_t columns = 4;

  static constexpr std::size_t fewest_columns = 3, most_columns = 16;
  bool operator==(const CloudLayout&) const = default;
  [[nodiscard]] std::size_t scalar_bytes() const { return scalar == Scalar::float32 ? 4 : 8; }
  [[nodiscard]] std::size_t point_bytes() const { return columns * scalar_bytes(); }
};

/// `float32x4`, `float64x3`, ...
[[nodiscard]] std::string to_string(const CloudLayout& layout);
/// Fails with `cloud_layout` for anything but float32x3 .. float32x16 and float64x3 .. float64x16.
[[nodiscard]] Result<CloudLayout> parse_cloud_layout(std::string_view word);

/// Fails with `cloud_layout` when `bytes` do not look like points of `layout`, and says which layout fits; with
/// `cloud_unreadable` when they are not whole points of any, as in a file that was cut off. Bytes that
/// are read with a wrong number of columns are all finite and within range, so that nothing else shows it.
///
/// - The bytes are whole points.
/// - At most one in five points has a coordinate that `is_measurable` refuses: the halves of 64-bit numbers look so.
/// - No other layout that passes these two explains the numbers better by 0.3 bits (by 0.5 bits with a multiple of the
///   columns). A column holds numbers of one kind, so that the entropy of a number's sign and magnitude (in half
///   octaves), given its column, is least for the right count of columns, whatever the order of the points. What
///   drivers write in place of a point does not count. Clouds of vehicles differ by 0.7 bits and more.
///
/// The last is not judged in fewer than 1000 numbers, nor in a layout that somebody has `stated`.
enum class LayoutIs { assumed, stated };
[[nodiscard]] Result<void> check_cloud_layout(std::string_view bytes, const CloudLayout& layout, LayoutIs known);

/// Whether a LiDAR can have measured this coordinate (m, or any other unit of length), which may also be 0 or not
/// finite. Bytes of another type or order become numbers below 1e-17 or beyond 1e7 more often than not.
[[nodiscard]] bool is_measurable(double coordinate);

/// Counts points with a coordinate that is not `is_measurable`.
class MeasurableCount {
 public:
  void add(double x, double y, double z);
  /// What is wrong, when it is more than one point in five.
  [[nodiscard]] std::optional<std::string> objection() const;

 private:
  std::uint64_t points_ = 0, refused_ = 0;
  double example_ = 0;
};

/// Names of the field that holds reflectance, in messages and files; the first of these that a cloud has is read.
inline constexpr std::array<std::string_view, 6> reflectance_names{"intensity", "reflectance", "reflectivity",
                                                                   "i",         "intensities", "echowidth"};

/// A step through `count` values by which about `wanted` of them are visited: a prime number that divides none of
/// `periods`, or 1. A step that shares a factor with the rings or columns of a LiDAR visits some of them only.
[[nodiscard]] std::uint64_t sampling_step(std::uint64_t count, std::uint64_t wanted,
                                          std::initializer_list<std::uint64_t> periods);

}  // namespace calib
