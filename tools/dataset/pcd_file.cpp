#include "dataset/pcd_file.hpp"

#include <algorithm>
#include <charconv>
#include <cstring>
#include <limits>
#include <optional>
#include <string>
#include <vector>

#include "dataset/cloud_points.hpp"

namespace calib {
namespace {

namespace fs = std::filesystem;

tl::unexpected<Error> unreadable(const fs::path& path, const std::string& why) {
  return fail(ErrorCode::cloud_unreadable, path.string() + " " + why);
}

/// One field of a point: where it lies and how it is written.
struct Field {
  char type = 'F';         // F, I or U
  std::size_t bytes = 4;   // of one value
  std::size_t offset = 0;  // binary: bytes from the start of the point
  std::size_t column = 0;  // ASCII: values before it on the line
  std::size_t packed = 0;  // binary_compressed: bytes per point of all fields before it

  [[nodiscard]] bool known() const {
    return type == 'F' ? bytes == 4 || bytes == 8 : (type == 'I' || type == 'U') && bytes <= 4 && bytes != 3;
  }
};

template <typename T>
double value_at(const char* bytes) {
  T value;
  std::memcpy(&value, bytes, sizeof value);
  return static_cast<double>(value);
}

double binary_value(const Field& field, const char* bytes) {
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
  std::optional<Field> x, y, z, reflectance;
  std::size_t points = 0, point_bytes = 0, columns = 0;
  std::size_t packed_bytes = 0;  // of a point in binary_compressed, which leaves padding out
  std::string encoding;
  std::vector<Error> remarks;
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

constexpr std::string_view white = " \t\r\v\f";

Words split(std::string_view line) {
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

/// The lines of the header; `text` then begins with the first point.
std::vector<Words> take_header_lines(std::string_view& text) {
  constexpr std::size_t most_lines = 32, longest_line = 16384;
  std::vector<Words> lines;
  while (lines.size() < most_lines) {
    const auto line = take_line(text);
    if (!line || line->size() > longest_line) break;
    const Words words = split(*line);
    if (words.empty() || words.front().front() == '#') continue;
    lines.push_back(words);
    if (words.front() == "DATA") break;
  }
  return lines;
}

/// What lines the header lacks, or which is not as long as it must be; empty when it is whole.
std::string fault_of_header(const std::vector<Words>& lines) {
  const std::size_t fields = words_of(lines, "FIELDS").size();
  if (fields == 0) return "the line FIELDS is missing";
  for (const char* key : {"SIZE", "TYPE", "COUNT"}) {
    const std::size_t values = words_of(lines, key).size();
    if (values == 0 && std::string_view(key) == "COUNT") continue;  // 1 each
    if (values == 0) return std::string("the line ") + key + " is missing";
    if (values != fields)
      return std::string(key) + " has " + std::to_string(values) + " values for " + std::to_string(fields) + " FIELDS";
  }
  const bool sized = words_of(lines, "WIDTH").size() == 1 && words_of(lines, "HEIGHT").size() == 1;
  if (words_of(lines, "POINTS").size() != 1 && !sized) return "the line POINTS is missing";
  if (words_of(lines, "DATA").size() != 1) return "the line DATA is missing";
  return {};
}

/// Takes all up to and with the DATA line off the front of `text`, which then begins with the first point.
Result<PcdHeader> take_pcd_header(std::string_view& text, const fs::path& path) {
  constexpr std::size_t most_values = 8192;
  const std::vector<Words> lines = take_header_lines(text);
  if (const std::string fault = fault_of_header(lines); !fault.empty())
    return unreadable(path, "has no whole PCD header (FIELDS, SIZE, TYPE, POINTS, DATA): " + fault);
  const auto names = words_of(lines, "FIELDS"), sizes = words_of(lines, "SIZE"), types = words_of(lines, "TYPE"),
             counts = words_of(lines, "COUNT"), points = words_of(lines, "POINTS");

  PcdHeader header;
  header.points = points.size() == 1 ? count_of(points[0])
                                     : std::min<std::size_t>(count_of(words_of(lines, "WIDTH")[0]), UINT32_MAX) *
                                           std::min<std::size_t>(count_of(words_of(lines, "HEIGHT")[0]), UINT32_MAX);
  header.encoding = words_of(lines, "DATA")[0];
  std::size_t preference = reflectance_names.size();
  for (std::size_t i = 0; i < names.size(); ++i) {
    const std::size_t bytes = count_of(sizes[i]), count = counts.empty() ? 1 : count_of(counts[i]);
    if (bytes == 0 || bytes > 8 || count > most_values)
      return unreadable(path, "has a PCD field of an impossible size");
    const Field field{types[i][0], bytes, header.point_bytes, header.columns, header.packed_bytes};
    header.point_bytes += bytes * count;
    header.columns += count;
    if (names[i] != "_") header.packed_bytes += bytes * count;
    if (header.columns > most_values) return unreadable(path, "has points of more than 8192 values");
    auto* const axis = names[i] == "x"   ? &header.x
                       : names[i] == "y" ? &header.y
                       : names[i] == "z" ? &header.z
                                         : nullptr;
    if (axis && (!field.known() || count != 1))
      return unreadable(path, "has a field " + escape_control(names[i]) + " of an unknown type");
    if (axis) *axis = field;
    const auto name =
        static_cast<std::size_t>(std::ranges::find(reflectance_names, names[i]) - reflectance_names.begin());
    if (name >= preference) continue;
    if (field.known() && count == 1)
      header.reflectance = field, preference = name;
    else
      header.remarks.push_back(
          {ErrorCode::cloud_unreadable, "the field " + escape_control(names[i]) + " of an unknown type is left out"});
  }
  if (!header.x || !header.y || !header.z) return unreadable(path, "has no fields x, y and z");
  return header;
}

Result<LidarScan> read_binary_points(const PcdHeader& header, std::string_view bytes, const fs::path& path) {
  if (bytes.size() / header.point_bytes < header.points) return unreadable(path, "ends before its last point");
  CloudPoints points;
  for (std::size_t i = 0; i < header.points; ++i) {
    const char* point = bytes.data() + i * header.point_bytes;
    const auto value = [&](const std::optional<Field>& field) {
      return field ? binary_value(*field, point + field->offset) : 0.0;
    };
    points.add(value(header.x), value(header.y), value(header.z), value(header.reflectance));
  }
  return points.take(path);
}

/// What LZF (Marc Lehmann's LibLZF, whose format PCL uses) makes of `in`: exactly `size` bytes, or nothing. A byte
/// below 32 precedes so many bytes and one more, literally. Any other refers to earlier output: 3 bits of length, 13 of
/// distance; a length of 7 is extended by a byte.
std::optional<std::string> decompress_lzf(std::string_view in, std::size_t size) {
  std::string out;
  out.reserve(size);
  const auto byte = [&](std::size_t at) { return static_cast<std::uint8_t>(in[at]); };
  for (std::size_t at = 0; at < in.size();) {
    const std::size_t control = byte(at++);
    if (control < 32) {
      const std::size_t length = control + 1;
      if (length > in.size() - at || length > size - out.size()) return std::nullopt;
      out.append(in.substr(at, length));
      at += length;
      continue;
    }
    std::size_t length = (control >> 5) + 2;
    if (length == 9) {
      if (at >= in.size()) return std::nullopt;
      length += byte(at++);
    }
    if (at >= in.size()) return std::nullopt;
    const std::size_t distance = ((control & 31) << 8) + byte(at++) + 1;
    if (distance > out.size() || length > size - out.size()) return std::nullopt;
    for (std::size_t i = 0; i < length; ++i) out.push_back(out[out.size() - distance]);  // may overlap its own output
  }
  return out.size() == size ? std::optional(std::move(out)) : std::nullopt;
}

/// All values of the first field, then all of the second, and so on; compressed together.
Result<LidarScan> read_compressed_points(const PcdHeader& header, std::string_view bytes, const fs::path& path) {
  constexpr std::size_t most_bytes = 256 << 20;
  std::uint32_t compressed = 0, uncompressed = 0;
  if (bytes.size() < 8) return unreadable(path, "ends before its last point");
  std::memcpy(&compressed, bytes.data(), 4);
  std::memcpy(&uncompressed, bytes.data() + 4, 4);
  bytes.remove_prefix(8);
  if (compressed > bytes.size()) return unreadable(path, "ends before its last point");
  // With a bound of its own before the product, which may overflow.
  if (uncompressed > most_bytes || header.points > most_bytes || uncompressed != header.points * header.packed_bytes)
    return unreadable(path, "has compressed points of " + std::to_string(uncompressed) +
                                " bytes, where its header has " + std::to_string(header.points) + " points of " +
                                std::to_string(header.packed_bytes) + " bytes, and up to 256 MiB are read");
  const auto plain = decompress_lzf(bytes.substr(0, compressed), uncompressed);
  if (!plain) return unreadable(path, "does not decompress: it is damaged");
  CloudPoints points;
  for (std::size_t i = 0; i < header.points; ++i) {
    const auto value = [&](const std::optional<Field>& field) {
      return field ? binary_value(*field, plain->data() + field->packed * header.points + field->bytes * i) : 0.0;
    };
    points.add(value(header.x), value(header.y), value(header.z), value(header.reflectance));
  }
  return points.take(path);
}

/// Takes a number off the front of a line: also one with a plus sign, and what C libraries print for a number that is
/// none (`nan`, `-1.#IND`, `1.#QNAN`).
std::optional<double> take_number(std::string_view& line) {
  line.remove_prefix(std::min(line.find_first_not_of(white), line.size()));
  const std::string_view word = line.substr(0, line.find_first_of(white));
  line.remove_prefix(word.size());
  const std::string_view digits = word.starts_with('+') ? word.substr(1) : word;
  double value = 0;
  const auto [end, error] = std::from_chars(digits.data(), digits.data() + digits.size(), value);
  const std::string_view rest(end, static_cast<std::size_t>(digits.data() + digits.size() - end));
  if (error == std::errc::invalid_argument || (!rest.empty() && !rest.starts_with('#'))) return std::nullopt;
  if (!rest.empty() || error != std::errc()) return std::numeric_limits<double>::quiet_NaN();
  return value;
}

Result<LidarScan> read_ascii_points(const PcdHeader& header, std::string_view bytes, const fs::path& path) {
  CloudPoints points;
  std::vector<double> values(header.columns);
  for (std::size_t i = 0; i < header.points; ++i) {
    const auto line = take_line(bytes);
    if (!line) return unreadable(path, "ends before its last point");
    std::string_view left = *line;
    for (double& value : values) {
      const auto number = take_number(left);
      if (!number) return unreadable(path, "has a line that is no point: " + excerpt(*line));
      value = *number;
    }
    const auto value = [&](const std::optional<Field>& field) { return field ? values[field->column] : 0.0; };
    points.add(value(header.x), value(header.y), value(header.z), value(header.reflectance));
  }
  return points.take(path);
}

}  // namespace

Result<LidarScan> read_pcd(std::string_view bytes, const fs::path& path) {
  auto header = take_pcd_header(bytes, path);
  if (!header) return propagate(header);
  auto scan = header->encoding == "ascii"               ? read_ascii_points(*header, bytes, path)
              : header->encoding == "binary"            ? read_binary_points(*header, bytes, path)
              : header->encoding == "binary_compressed" ? read_compressed_points(*header, bytes, path)
                                                        : unreadable(path, "is stored as " + excerpt(header->encoding) +
                                                                               ", which is none of ascii, binary and "
                                                                               "binary_compressed");
  if (scan) scan->notes.remarks = std::move(header->remarks);
  return scan;
}

}  // namespace calib
