#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstring>
#include <optional>
#include <span>
#include <string_view>

#include "calib/cloud_layout.hpp"
#include "dds/decode.hpp"

namespace calib {
namespace {

constexpr std::uint32_t max_point_step = 4096;
constexpr std::uint32_t max_fields = 64;
constexpr double max_range_m = 500;

std::string_view text(const char* string) { return string ? std::string_view(string) : std::string_view(); }

/// The datatypes of sensor_msgs/PointField, in their order from 1.
enum class Datatype : std::uint8_t { int8 = 1, uint8, int16, uint16, int32, uint32, float32, float64 };

std::uint64_t size_of(Datatype type) {
  switch (type) {
    case Datatype::int8:
    case Datatype::uint8:
      return 1;
    case Datatype::int16:
    case Datatype::uint16:
      return 2;
    case Datatype::int32:
    case Datatype::uint32:
    case Datatype::float32:
      return 4;
    case Datatype::float64:
      return 8;
  }
  return 0;
}

/// A scalar at any address, in either byte order.
template <typename T>
double read_as(const std::uint8_t* bytes, bool swap) {
  std::array<std::uint8_t, sizeof(T)> raw;
  std::memcpy(raw.data(), bytes, sizeof(T));
  if (swap) std::ranges::reverse(raw);
  return static_cast<double>(std::bit_cast<T>(raw));
}

double read_scalar(const std::uint8_t* bytes, Datatype type, bool swap) {
  switch (type) {
    case Datatype::int8:
      return read_as<std::int8_t>(bytes, swap);
    case Datatype::uint8:
      return read_as<std::uint8_t>(bytes, swap);
    case Datatype::int16:
      return read_as<std::int16_t>(bytes, swap);
    case Datatype::uint16:
      return read_as<std::uint16_t>(bytes, swap);
    case Datatype::int32:
      return read_as<std::int32_t>(bytes, swap);
    case Datatype::uint32:
      return read_as<std::uint32_t>(bytes, swap);
    case Datatype::float32:
      return read_as<float>(bytes, swap);
    case Datatype::float64:
      return read_as<double>(bytes, swap);
  }
  return 0;
}

struct Field {
  std::uint32_t offset = 0;
  Datatype type = Datatype::float32;
};

struct PointLayout {
  Field x, y, z;
  std::optional<Field> reflectance;
};

/// A count of 0 means 1, as PCL writes it.
std::uint32_t count_of(const sensor_msgs_msg_dds__PointField_& field) { return std::max(field.count, 1U); }

/// Why a field cannot be read.
std::optional<Error> fault_of(const sensor_msgs_msg_dds__PointField_& field, std::uint32_t point_step) {
  const std::string shown = "field '" + escape_control(text(field.name).substr(0, 32)) + "' ";
  if (field.datatype < 1 || field.datatype > 8)
    return Error{ErrorCode::malformed_field_type,
                 shown + "has datatype " + std::to_string(field.datatype) + ", which is none of 1 .. 8"};
  const std::uint64_t size = size_of(static_cast<Datatype>(field.datatype));
  const std::uint64_t end = std::uint64_t{field.offset} + size * count_of(field);
  if (end > point_step)
    return Error{ErrorCode::malformed_field_bounds,
                 shown + "ends at byte " + std::to_string(end) + " (offset " + std::to_string(field.offset) + ", " +
                     std::to_string(count_of(field)) + " of " + std::to_string(size) +
                     " bytes), after point_step, which is " + std::to_string(point_step)};
  return std::nullopt;
}

/// One of x, y and z, into `axis`.
Result<void> take_axis(const sensor_msgs_msg_dds__PointField_& field, std::optional<Field>& axis) {
  const std::string name(text(field.name));
  const auto type = static_cast<Datatype>(field.datatype);
  if (axis) return fail(ErrorCode::malformed_xyz, "field " + name + " is there twice");
  if (count_of(field) != 1 || (type != Datatype::float32 && type != Datatype::float64))
    return fail(ErrorCode::malformed_xyz, "field " + name + " is " + std::to_string(field.count) + " of datatype " +
                                              std::to_string(field.datatype) +
                                              ", where one FLOAT32 (7) or FLOAT64 (8) is needed");
  axis = Field{field.offset, type};
  return {};
}

/// A fault of another field than x, y and z costs that field and is remarked.
Result<PointLayout> point_layout(const sensor_msgs_msg_dds__PointCloud2_& message, MessageNotes& notes) {
  if (message.fields._length > max_fields)
    return fail(ErrorCode::malformed_fields, std::to_string(message.fields._length) + " fields where " +
                                                 std::to_string(max_fields) + " are allowed");
  std::array<std::optional<Field>, 3> xyz;
  std::optional<Field> reflectance;
  std::size_t preference = reflectance_names.size();
  std::string names;
  for (const auto& field : std::span(message.fields._buffer, message.fields._length)) {
    const std::string_view name = text(field.name);
    const bool is_axis = name == "x" || name == "y" || name == "z";
    if (names.size() < 200) names += (names.empty() ? "" : ", ") + escape_control(name.substr(0, 32));
    if (auto fault = fault_of(field, message.point_step)) {
      if (is_axis) return tl::unexpected(std::move(*fault));
      add_remark(notes, fault->code, fault->context + "; the field is left out");
      continue;
    }
    if (is_axis) {
      if (const auto taken = take_axis(field, xyz[name[0] - 'x']); !taken) return propagate(taken);
      continue;
    }
    const auto known = static_cast<std::size_t>(std::ranges::find(reflectance_names, name) - reflectance_names.begin());
    if (known >= preference) continue;
    preference = known;
    reflectance = Field{field.offset, static_cast<Datatype>(field.datatype)};
  }
  if (!xyz[0] || !xyz[1] || !xyz[2])
    return fail(ErrorCode::malformed_xyz, "a cloud needs the fields x, y and z, and this one has " +
                                              (names.empty() ? std::string("no field") : names));
  return PointLayout{*xyz[0], *xyz[1], *xyz[2], reflectance};
}

/// Counts the points of a cloud and keeps an even sample of their ranges.
class Ranges {
 public:
  Ranges(std::uint64_t width, std::uint64_t height) : step_(sampling_step(width * height, 2048, {width, height})) {}

  /// Returns whether the point is kept.
  bool count(double range_m, CloudStatistics& statistics) {
    ++statistics.points;
    statistics.not_finite += !std::isfinite(range_m);
    statistics.at_origin += range_m == 0;
    if (!std::isfinite(range_m) || range_m == 0) return false;
    if (measured_++ % step_ == 0) sample_.push_back(range_m);
    statistics.too_far += range_m > max_range_m;
    return range_m <= max_range_m;
  }
  [[nodiscard]] double median() {
    if (sample_.empty()) return 0;
    const auto middle = sample_.begin() + static_cast<std::ptrdiff_t>(sample_.size() / 2);
    std::ranges::nth_element(sample_, middle);
    return *middle;
  }

 private:
  std::uint64_t step_, measured_ = 0;
  std::vector<double> sample_;
};

/// Bytes from one row to the next. The last row needs no padding. `row_step` is redundant where there is one row (some
/// drivers set it to 0 or to the capacity of their buffer), and where the data has exactly the length of rows without
/// padding.
Result<std::uint64_t> row_step(const sensor_msgs_msg_dds__PointCloud2_& message, std::uint64_t row_bytes,
                               MessageNotes& notes) {
  const std::uint64_t height = message.height, length = message.data._length;
  const std::string given =
      "row_step is " + std::to_string(message.row_step) + ", and width * point_step is " + std::to_string(row_bytes);
  const bool fits = message.row_step >= row_bytes && message.row_step <= row_bytes + max_row_padding;
  const bool packed = length == height * row_bytes;
  std::uint64_t step = message.row_step;
  if (height == 1 || (!fits && packed)) step = row_bytes;
  if (height > 1 && !fits && packed)
    add_remark(notes, ErrorCode::malformed_row_step, given + "; the data is read as rows without padding");
  if (step < row_bytes) return fail(ErrorCode::malformed_row_step, given + ", which is more");
  const std::uint64_t needed = (height - 1) * step + row_bytes;
  const std::string sizes = std::to_string(length) +
                            " bytes of data, where height, row_step, width and point_step need " +
                            std::to_string(needed);
  if (length < needed) return fail(ErrorCode::malformed_cloud_data, sizes);
  if (step > row_bytes + max_row_padding)
    return fail(ErrorCode::malformed_row_step, given + ": a padding of more than " + std::to_string(max_row_padding));
  if (length > needed + max_row_padding + max_data_slack)
    return fail(ErrorCode::malformed_cloud_data,
                sizes + " and " + std::to_string(max_row_padding + max_data_slack) + " more are allowed");
  return step;
}

}  // namespace

Result<DecodedCloud> decode_cloud(const sensor_msgs_msg_dds__PointCloud2_& message, std::uint64_t max_points) {
  const auto stamp = decode_stamp(message.header);
  if (!stamp) return propagate(stamp);
  if (message.point_step < 1 || message.point_step > max_point_step)
    return fail(ErrorCode::malformed_point_step,
                "point_step is " + std::to_string(message.point_step) + ", which is outside 1 .. 4096");
  const std::uint64_t width = message.width, height = message.height, points = width * height;
  if (points > max_points)
    return fail(ErrorCode::malformed_cloud_size, std::to_string(points) + " points where " +
                                                     std::to_string(max_points) + " are allowed (lidar.max_points)");
  DecodedCloud scan{{*stamp, {}, notes_of(message.header)}};
  const auto layout = point_layout(message, scan.notes);
  if (!layout) return propagate(layout);
  scan.has_reflectance = layout->reflectance.has_value();
  if (points == 0 && message.data._length <= max_data_slack) return scan;
  if (points == 0)
    return fail(ErrorCode::malformed_cloud_data,
                std::to_string(message.data._length) + " bytes of data without points (width * height is 0)");
  const auto step = row_step(message, width * message.point_step, scan.notes);
  if (!step) return propagate(step);

  const bool swap = message.is_bigendian != (std::endian::native == std::endian::big);
  scan.points.reserve(points);
  Ranges ranges(width, height);
  MeasurableCount measurable;
  for (std::uint64_t row = 0; row < height; ++row) {
    const std::uint8_t* point = message.data._buffer + row * *step;
    for (std::uint64_t column = 0; column < width; ++column, point += message.point_step) {
      const auto read = [&](const Field& field) { return read_scalar(point + field.offset, field.type, swap); };
      const double x = read(layout->x), y = read(layout->y), z = read(layout->z);
      measurable.add(x, y, z);
      if (!ranges.count(std::hypot(x, y, z), scan.statistics)) continue;
      const float reflectance = layout->reflectance ? static_cast<float>(read(*layout->reflectance)) : 0.0F;
      scan.points.push_back({static_cast<float>(x), static_cast<float>(y), static_cast<float>(z),
                             std::isfinite(reflectance) ? reflectance : 0.0F});
    }
  }
  if (const auto objection = measurable.objection())
    return fail(ErrorCode::malformed_cloud_layout,
                *objection + "; is_bigendian is " + (message.is_bigendian ? "true" : "false") +
                    ": is it right, and are the offsets and datatypes of x, y and z?");
  scan.statistics.median_range_m = ranges.median();
  return scan;
}

}  // namespace calib
