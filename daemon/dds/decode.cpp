#include "dds/decode.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <optional>
#include <span>
#include <string_view>

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

Result<PointLayout> point_layout(const sensor_msgs_msg_dds__PointCloud2_& message) {
  if (message.fields._length > max_fields)
    return fail(ErrorCode::malformed_fields, std::to_string(message.fields._length) + " fields where 64 are allowed");
  std::array<std::optional<Field>, 3> xyz;
  std::optional<Field> intensity, reflectance;
  for (const auto& field : std::span(message.fields._buffer, message.fields._length)) {
    if (field.datatype < 1 || field.datatype > 8)
      return fail(ErrorCode::malformed_field_type, "datatype " + std::to_string(field.datatype) + " is none of 1 .. 8");
    const auto type = static_cast<Datatype>(field.datatype);
    if (std::uint64_t{field.offset} + size_of(type) * field.count > message.point_step)
      return fail(ErrorCode::malformed_field_bounds, "a field ends after point_step");
    const std::string_view name = text(field.name);
    if (name == "x" || name == "y" || name == "z") {
      std::optional<Field>& axis = xyz[name[0] - 'x'];
      if (axis || field.count != 1 || (type != Datatype::float32 && type != Datatype::float64))
        return fail(ErrorCode::malformed_xyz,
                    "field " + std::string(name) + " must be there once, as one FLOAT32 or FLOAT64");
      axis = Field{field.offset, type};
    } else if (field.count >= 1 && name == "intensity") {
      intensity = Field{field.offset, type};
    } else if (field.count >= 1 && name == "reflectance") {
      reflectance = Field{field.offset, type};
    }
  }
  if (!xyz[0] || !xyz[1] || !xyz[2]) return fail(ErrorCode::malformed_xyz, "a cloud needs the fields x, y and z");
  return PointLayout{*xyz[0], *xyz[1], *xyz[2], intensity ? intensity : reflectance};
}

/// Counts the points of a cloud and keeps an even sample of their ranges.
class Ranges {
 public:
  explicit Ranges(std::uint64_t points) : stride_(std::max<std::uint64_t>(1, points / 2048)) {}

  /// Returns whether the point is kept.
  bool count(double range_m, CloudStatistics& statistics) {
    const bool sampled = statistics.points++ % stride_ == 0;
    statistics.not_finite += !std::isfinite(range_m);
    statistics.at_origin += range_m == 0;
    if (!std::isfinite(range_m) || range_m == 0) return false;
    if (sampled) sample_.push_back(range_m);
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
  std::uint64_t stride_;
  std::vector<double> sample_;
};

/// Checks `height` rows of `row_bytes`. The last row needs no padding. The row_step of a cloud with one row is ignored:
/// some drivers set it to the capacity of their buffer.
Result<void> check_rows(const sensor_msgs_msg_dds__PointCloud2_& message, std::uint64_t height,
                        std::uint64_t row_bytes) {
  if (message.row_step < row_bytes)
    return fail(ErrorCode::malformed_row_step,
                "row_step is less than width * point_step = " + std::to_string(row_bytes));
  const std::uint64_t needed = (height - 1) * message.row_step + row_bytes;
  if (message.data._length < needed)
    return fail(ErrorCode::malformed_cloud_data, "fewer bytes of data than height, row_step and width need");
  if (height > 1 && message.row_step > row_bytes + max_row_padding)
    return fail(ErrorCode::malformed_row_step, "rows are padded by more than 4096 bytes");
  if (message.data._length > needed + max_row_padding + max_data_slack)
    return fail(ErrorCode::malformed_cloud_data, "more bytes of data than height, row_step and width need");
  return {};
}

bool all_finite(std::span<const double> values) {
  return std::ranges::all_of(values, [](double value) { return std::isfinite(value); });
}

struct Lens {
  CameraModel model;
  std::vector<double> distortion;
};

/// The camera model that CameraInfo calls `name`; nothing for a name that no model has.
const CameraModelFacts* model_of(std::string_view name) {
  const auto found = std::ranges::find_if(all_camera_models, [&](const CameraModelFacts& model) {
    return model.ros && (name == model.ros->name || name == model.ros->other_name);
  });
  return found == all_camera_models.end() ? nullptr : &*found;
}

/// What CameraInfo may call a lens, "none" last.
std::string model_names() {
  std::string names;
  for (const CameraModelFacts& model : all_camera_models) {
    if (!model.ros || model.parameters.empty()) continue;
    names += std::string(model.ros->name) + ", ";
    if (model.ros->other_name != model.ros->name) names += std::string(model.ros->other_name) + ", ";
  }
  return names + "none";
}

/// The coefficients of a distortion model as `Camera` takes them.
Result<Lens> lens(std::string_view name, std::span<const double> d) {
  const std::string shown = "distortion model '" + escape_control(name.substr(0, 32)) + "' ";
  const std::string counted = shown + "with " + std::to_string(d.size()) + " coefficients in D: ";
  if (!all_finite(d)) return fail(ErrorCode::malformed_distortion, counted + "one is not finite");
  const CameraModelFacts* const model = model_of(name);
  if (model == nullptr) return fail(ErrorCode::malformed_distortion, shown + "is none of " + model_names());
  const std::size_t own = model->parameters.size();
  // The larger models of OpenCV add thin prism and tilt, which no model here has.
  const bool others_are_zero =
      std::ranges::all_of(d.subspan(std::min(own, d.size())), [](double value) { return value == 0; });
  if (!model->ros->takes(d.size()) || !others_are_zero)
    return fail(ErrorCode::malformed_distortion, counted + std::string(model->ros->needed));
  Lens lens{model->model, {d.begin(), d.end()}};
  lens.distortion.resize(own, 0.0);
  return lens;
}

/// The part of the sensor that an image shows, along one side.
struct Extent {
  std::uint64_t offset, pixels, binning;

  [[nodiscard]] int image_pixels() const { return static_cast<int>(pixels / binning); }
  void adjust(double& focal, double& centre) const {
    focal /= static_cast<double>(binning);
    centre = (centre - static_cast<double>(offset) + 0.5) / static_cast<double>(binning) - 0.5;
  }
};

/// A roi of 0 pixels extends from its offset to the end; a binning of 0 means 1.
Result<Extent> extent(std::uint32_t full, std::uint32_t offset, std::uint32_t roi, std::uint32_t binning) {
  if (offset >= full || roi > full - offset)
    return fail(ErrorCode::malformed_roi, "the roi exceeds the " + std::to_string(full) + " pixels of the full image");
  const Extent extent{offset, roi == 0 ? full - offset : roi, std::max(binning, 1U)};
  if (extent.binning > extent.pixels)
    return fail(ErrorCode::malformed_roi, "a binning of " + std::to_string(binning) + " leaves no pixel of the roi");
  return extent;
}

}  // namespace

Result<Timestamp> decode_stamp(const std_msgs_msg_dds__Header_& header) {
  if (header.stamp.sec < 0 || header.stamp.nanosec >= 1'000'000'000)
    return fail(ErrorCode::malformed_stamp, "a stamp needs sec >= 0 and nanosec < 1e9");
  return std::chrono::seconds(header.stamp.sec) + std::chrono::nanoseconds(header.stamp.nanosec);
}

Result<DecodedCloud> decode_cloud(const sensor_msgs_msg_dds__PointCloud2_& message, std::uint64_t max_points) {
  const auto stamp = decode_stamp(message.header);
  if (!stamp) return propagate(stamp);
  if (message.point_step < 1 || message.point_step > max_point_step)
    return fail(ErrorCode::malformed_point_step, std::to_string(message.point_step) + " is outside 1 .. 4096");
  const std::uint64_t width = message.width, height = message.height, points = width * height;
  if (points > max_points)
    return fail(ErrorCode::malformed_cloud_size, std::to_string(points) + " points where " +
                                                     std::to_string(max_points) + " are allowed (lidar.max_points)");
  const auto layout = point_layout(message);
  if (!layout) return propagate(layout);
  DecodedCloud scan{{*stamp, {}}};
  const std::uint64_t row_bytes = width * message.point_step;
  if (points == 0 && message.data._length <= max_data_slack) return scan;
  if (points == 0) return fail(ErrorCode::malformed_cloud_data, "data without points");
  if (const auto sound = check_rows(message, height, row_bytes); !sound) return propagate(sound);

  const bool swap = message.is_bigendian != (std::endian::native == std::endian::big);
  scan.points.reserve(points);
  Ranges ranges(points);
  for (std::uint64_t row = 0; row < height; ++row) {
    const std::uint8_t* point = message.data._buffer + row * message.row_step;
    for (std::uint64_t column = 0; column < width; ++column, point += message.point_step) {
      const auto read = [&](const Field& field) { return read_scalar(point + field.offset, field.type, swap); };
      const double x = read(layout->x), y = read(layout->y), z = read(layout->z);
      if (!ranges.count(std::hypot(x, y, z), scan.statistics)) continue;
      const float reflectance = layout->reflectance ? static_cast<float>(read(*layout->reflectance)) : 0.0F;
      scan.points.push_back({static_cast<float>(x), static_cast<float>(y), static_cast<float>(z),
                             std::isfinite(reflectance) ? reflectance : 0.0F});
    }
  }
  scan.statistics.median_range_m = ranges.median();
  return scan;
}

Result<CameraInfo> decode_camera_info(const sensor_msgs_msg_dds__CameraInfo_& message) {
  const auto stamp = decode_stamp(message.header);
  if (!stamp) return propagate(stamp);
  const std::uint64_t pixels = std::uint64_t{message.width} * message.height;
  if (pixels < 1 || pixels > max_image_pixels)
    return fail(ErrorCode::malformed_image_size, std::to_string(pixels) + " pixels are outside 1 .. 64 Mpx");
  const auto across = extent(message.width, message.roi.x_offset, message.roi.width, message.binning_x);
  if (!across) return propagate(across);
  const auto down = extent(message.height, message.roi.y_offset, message.roi.height, message.binning_y);
  if (!down) return propagate(down);
  const auto distortion =
      lens(text(message.distortion_model), std::span<const double>(message.d._buffer, message.d._length));
  if (!distortion) return propagate(distortion);

  CameraInfo info{.stamp = *stamp,
                  .width = across->image_pixels(),
                  .height = down->image_pixels(),
                  .model = distortion->model,
                  .K = {},
                  .D = distortion->distortion,
                  .P = {},
                  .R = {}};
  std::ranges::copy(message.r, info.R.begin());
  std::ranges::copy(message.k, info.K.begin());
  std::ranges::copy(message.p, info.P.begin());
  across->adjust(info.K[0], info.K[2]);
  down->adjust(info.K[4], info.K[5]);
  across->adjust(info.P[0], info.P[2]);
  down->adjust(info.P[5], info.P[6]);
  info.P[3] /= static_cast<double>(across->binning);  // -fx times the baseline
  info.P[7] /= static_cast<double>(down->binning);
  const auto focal_in_range = [](double f) { return f > 1 && f < 1e5; };
  if (!all_finite(info.K) || !all_finite(info.P) || !focal_in_range(info.K[0]) || !focal_in_range(info.K[4]))
    return fail(ErrorCode::malformed_intrinsics, "K and P must be finite, with focal lengths in 1 .. 1e5 pixels");
  return info;
}

}  // namespace calib
