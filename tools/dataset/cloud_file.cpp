#include "dataset/cloud_file.hpp"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstring>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "calib/file.hpp"

namespace calib {
namespace {

namespace fs = std::filesystem;

tl::unexpected<Error> unreadable(const fs::path& path, const std::string& why) {
  return fail(ErrorCode::cloud_unreadable, path.string() + " " + why);
}

/// Keeps the points that a `LidarScan` may hold.
void add_point(LidarScan& scan, LidarPoint point) {
  const float range = std::hypot(point.x_m, point.y_m, point.z_m);
  if (!(range > 0 && range <= 500)) return;  // NaN fails both
  if (!std::isfinite(point.reflectance)) point.reflectance = 0;
  scan.points.push_back(point);
}

/// One field of a point: where it lies and how it is written.
struct Field {
  char type = 'F';         // F, I or U
  std::size_t bytes = 4;   // of one value
  std::size_t offset = 0;  // binary: bytes from the start of the point
  std::size_t column = 0;  // ASCII: values before it on the line
};

template <typename T>
double value_at(const char* bytes) {
  T value;
  std::memcpy(&value, bytes, sizeof value);
  return static_cast<double>(value);
}

double binary_value(const Field& field, const char* point) {
  const char* bytes = point + field.offset;
  switch (field.type) {
    case 'F':
      return field.bytes == 4 ? value_at<float>(bytes) : value_at<double>(bytes);
    case 'I':
      return field.bytes == 1   ? value_at<std::int8_t>(bytes)
             : field.bytes == 2 ? value_at<std::int16_t>(bytes)
                                : value_at<std::int32_t>(bytes);
    default:
      return field.bytes == 1   ? value_at<std::uint8_t>(bytes)
             : field.bytes == 2 ? value_at<std::uint16_t>(bytes)
                                : value_at<std::uint32_t>(bytes);
  }
}

/// The header of a PCD file (Point Cloud Library, file format 0.7) as far as it matters here.
struct PcdHeader {
  std::optional<Field> x, y, z, intensity;
  std::size_t points = 0, point_bytes = 0, columns = 0;
  std::string encoding;
};

using Words = std::vector<std::string_view>;

/// The words of the header's line that begins with `key`, without the key.
Words words_of(const std::vector<Words>& lines, std::string_view key) {
  for (const Words& words : lines)
    if (words.front() == key) return {words.begin() + 1, words.end()};
  return {};
}

/// Takes a line off the front of `text`, without its end. Nothing when `text` is empty.
std::optional<std::string_view> take_line(std::string_view& text) {
  if (text.empty()) return std::nullopt;
  const std::string_view line = text.substr(0, text.find('\n'));
  text.remove_prefix(std::min(line.size() + 1, text.size()));
  return line;
}

Words split(std::string_view line) {
  constexpr std::string_view white = " \t\r\v\f";
  Words words;
  for (std::size_t begin = 0; (begin = line.find_first_not_of(white, begin)) != std::string_view::npos;) {
    words.push_back(line.substr(begin, line.find_first_of(white, begin) - begin));
    begin += words.back().size();
  }
  return words;
}

/// What a file says, as far as an error's text has room for it.
std::string excerpt(std::string_view text) {
  constexpr std::size_t longest = 80;
  return escape_control(text.substr(0, longest)) + (text.size() > longest ? "..." : "");
}

std::size_t count_of(std::string_view word) {
  std::size_t count = 0;
  std::from_chars(word.data(), word.data() + word.size(), count);
  return count;
}

/// Takes all up to and with the DATA line off the front of `text`, which then begins with the first point.
Result<PcdHeader> take_pcd_header(std::string_view& text, const fs::path& path) {
  constexpr std::size_t most_lines = 32, longest_line = 16384, most_values = 8192;
  std::vector<Words> lines;
  while (lines.size() < most_lines) {
    const auto line = take_line(text);
    if (!line || line->size() > longest_line) break;
    const Words words = split(*line);
    if (words.empty() || words.front().front() == '#') continue;
    lines.push_back(words);
    if (words.front() == "DATA") break;
  }
  const auto names = words_of(lines, "FIELDS"), sizes = words_of(lines, "SIZE"), types = words_of(lines, "TYPE"),
             counts = words_of(lines, "COUNT"), points = words_of(lines, "POINTS"), data = words_of(lines, "DATA");
  if (names.empty() || sizes.size() != names.size() || types.size() != names.size() || points.size() != 1 ||
      data.size() != 1 || (!counts.empty() && counts.size() != names.size()))
    return unreadable(path, "has no whole PCD header (FIELDS, SIZE, TYPE, POINTS, DATA)");

  PcdHeader header;
  header.points = count_of(points[0]);
  header.encoding = data[0];
  for (std::size_t i = 0; i < names.size(); ++i) {
    const std::size_t bytes = count_of(sizes[i]), count = counts.empty() ? 1 : count_of(counts[i]);
    if (bytes == 0 || bytes > 8 || count > most_values)
      return unreadable(path, "has a PCD field of an impossible size");
    const Field field{types[i][0], bytes, header.point_bytes, header.columns};
    header.point_bytes += bytes * count;
    header.columns += count;
    if (header.columns > most_values) return unreadable(path, "has points of more than 8192 values");
    auto* wanted = names[i] == "x"   ? &header.x
                   : names[i] == "y" ? &header.y
                   : names[i] == "z" ? &header.z
                   : names[i] == "intensity" || names[i] == "reflectance" || names[i] == "reflectivity"
                       ? &header.intensity
                       : nullptr;
    if (!wanted) continue;
    const bool known = field.type == 'F' ? bytes == 4 || bytes == 8
                                         : (field.type == 'I' || field.type == 'U') && bytes <= 4 && bytes != 3;
    if (!known || count != 1)
      return unreadable(path, "has a field " + escape_control(names[i]) + " of an unknown type");
    *wanted = field;
  }
  if (!header.x || !header.y || !header.z) return unreadable(path, "has no fields x, y and z");
  return header;
}

Result<LidarScan> read_binary_points(const PcdHeader& header, std::string_view bytes, const fs::path& path) {
  if (bytes.size() / header.point_bytes < header.points) return unreadable(path, "ends before its last point");
  LidarScan scan;
  for (std::size_t i = 0; i < header.points; ++i) {
    const char* point = bytes.data() + i * header.point_bytes;
    const auto value = [&](const std::optional<Field>& field) {
      return field ? static_cast<float>(binary_value(*field, point)) : 0.f;
    };
    add_point(scan, {value(header.x), value(header.y), value(header.z), value(header.intensity)});
  }
  return scan;
}

Result<LidarScan> read_ascii_points(const PcdHeader& header, std::string_view bytes, const fs::path& path) {
  LidarScan scan;
  std::vector<float> values(header.columns);
  for (std::size_t i = 0; i < header.points; ++i) {
    const auto line = take_line(bytes);
    if (!line) return unreadable(path, "ends before its last point");
    const char *at = line->data(), *end = at + line->size();
    for (float& value : values) {
      while (at < end && (*at == ' ' || *at == '\t')) ++at;
      const auto [after, error] = std::from_chars(at, end, value);
      if (error != std::errc()) return unreadable(path, "has a line that is no point: " + excerpt(*line));
      at = after;
    }
    const auto value = [&](const std::optional<Field>& field) { return field ? values[field->column] : 0.f; };
    add_point(scan, {value(header.x), value(header.y), value(header.z), value(header.intensity)});
  }
  return scan;
}

Result<LidarScan> read_pcd(std::string_view bytes, const fs::path& path) {
  const auto header = take_pcd_header(bytes, path);
  if (!header) return propagate(header);
  if (header->encoding == "ascii") return read_ascii_points(*header, bytes, path);
  if (header->encoding == "binary") return read_binary_points(*header, bytes, path);
  return unreadable(path, "is stored as " + excerpt(header->encoding) +
                              "; write it as binary (pcl_convert_pcd_ascii_binary IN OUT 1)");
}

Result<LidarScan> read_bin(std::string_view bytes, const fs::path& path) {
  if (bytes.size() % sizeof(LidarPoint) != 0)
    return unreadable(path, "does not hold whole points of four 32-bit floats");
  LidarScan scan;
  scan.points.reserve(bytes.size() / sizeof(LidarPoint));
  for (std::size_t i = 0; i < bytes.size(); i += sizeof(LidarPoint)) {
    LidarPoint point;
    std::memcpy(&point, bytes.data() + i, sizeof point);
    add_point(scan, point);
  }
  return scan;
}

}  // namespace

Result<LidarScan> read_cloud(const fs::path& path) {
  constexpr std::uint64_t most_bytes = 256 << 20;
  const bool pcd = path.extension() == ".pcd";
  if (!pcd && path.extension() != ".bin") return unreadable(path, "is neither .bin nor .pcd");
  const auto bytes = read_regular_file(path, most_bytes);
  if (!bytes) return fail(ErrorCode::cloud_unreadable, bytes.error().context);
  auto scan = pcd ? read_pcd(*bytes, path) : read_bin(*bytes, path);
  if (scan && scan->points.empty()) return fail(ErrorCode::cloud_empty, path.string() + " holds no point");
  return scan;
}

Result<void> write_cloud(const fs::path& path, const LidarScan& scan) {
  return replace_file(path,
                      {reinterpret_cast<const char*>(scan.points.data()), scan.points.size() * sizeof(LidarPoint)});
}

}  // namespace calib
