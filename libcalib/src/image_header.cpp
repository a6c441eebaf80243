#include "calib/image_header.hpp"

#include <algorithm>
#include <charconv>
#include <cstddef>
#include <cstdlib>

namespace calib {
namespace {

enum class Order { big_endian, little_endian };

/// Numbers at places of the bytes; beyond the end they are 0 and `whole` becomes false.
class Numbers {
 public:
  Numbers(std::string_view bytes, Order order) : bytes_(bytes), order_(order) {}
  std::uint32_t at(std::uint64_t place, std::uint32_t size) {
    if (place > bytes_.size() || bytes_.size() - place < size) {
      whole_ = false;
      return 0;
    }
    std::uint32_t value = 0;
    for (std::uint32_t i = 0; i < size; ++i) {
      const std::uint64_t next = order_ == Order::big_endian ? place + i : place + size - 1 - i;
      value = value << 8 | static_cast<std::uint8_t>(bytes_[next]);
    }
    return value;
  }
  [[nodiscard]] bool whole() const { return whole_; }

 private:
  std::string_view bytes_;
  Order order_;
  bool whole_ = true;
};

/// From IHDR, which is always the first chunk.
std::optional<ImageHeader> png(std::string_view bytes) {
  if (bytes.size() < 24 || bytes.substr(12, 4) != "IHDR") return std::nullopt;
  Numbers numbers(bytes, Order::big_endian);
  return ImageHeader{numbers.at(16, 4), numbers.at(20, 4)};
}

/// Behind the entropy-coded data of a scan that begins at `at`: where the next segment begins.
std::size_t end_of_scan(std::string_view bytes, std::size_t at) {
  for (; (at = bytes.find('\xff', at)) < bytes.size(); ++at) {
    const auto next = at + 1 < bytes.size() ? static_cast<std::uint8_t>(bytes[at + 1]) : 0;
    const bool data = next == 0 || (next >= 0xd0 && next <= 0xd7);  // a stuffed byte, or a restart
    if (!data) return at;
  }
  return bytes.size();
}

/// From the first start of frame. A thumbnail lies inside a segment, and is skipped with it.
std::optional<ImageHeader> jpeg(std::string_view bytes) {
  Numbers numbers(bytes, Order::big_endian);
  std::optional<ImageHeader> header;
  int scans = 0;
  bool ended = false;
  for (std::size_t at = 2; at + 2 <= bytes.size();) {
    const std::uint32_t prefix = numbers.at(at, 1), marker = numbers.at(at + 1, 1);
    if (prefix != 0xff || marker == 0xff) {  // libjpeg skips fill bytes, and what does not belong there, too
      ++at;
      continue;
    }
    if (marker == 0xd9) {
      ended = true;
      break;
    }
    if (marker <= 0x01 || (marker >= 0xd0 && marker <= 0xd8)) {  // no segment follows
      at += 2;
      continue;
    }
    const bool start_of_frame = marker >= 0xc0 && marker <= 0xcf && marker != 0xc4 && marker != 0xc8 && marker != 0xcc;
    if (start_of_frame && !header) header = ImageHeader{numbers.at(at + 7, 2), numbers.at(at + 5, 2)};
    at += 2 + numbers.at(at + 2, 2);
    if (marker == 0xda) {
      ++scans;
      at = end_of_scan(bytes, at);
    }
  }
  if (!header || !numbers.whole()) return std::nullopt;
  header->scans = scans;
  header->complete = ended && scans > 0;
  return header;
}

/// From the first directory, with 32-bit places: BigTIFF has others.
std::optional<ImageHeader> tiff(std::string_view bytes, Order order) {
  constexpr std::uint32_t tag_width = 256, tag_height = 257, of_16_bits = 3, of_32_bits = 4;
  Numbers numbers(bytes, order);
  const std::uint64_t directory = numbers.at(4, 4);
  const std::uint32_t entries = numbers.at(directory, 2);
  ImageHeader header;
  for (std::uint32_t i = 0; i < entries && numbers.whole(); ++i) {
    const std::uint64_t entry = directory + 2 + std::uint64_t{12} * i;
    const std::uint32_t tag = numbers.at(entry, 2), type = numbers.at(entry + 2, 2);
    if (tag != tag_width && tag != tag_height) continue;
    std::int64_t& side = tag == tag_width ? header.width : header.height;
    if ((type != of_16_bits && type != of_32_bits) || side != 0) return std::nullopt;
    side = numbers.at(entry + 8, type == of_16_bits ? 2 : 4);
  }
  return numbers.whole() ? std::optional(header) : std::nullopt;
}

std::optional<ImageHeader> bmp(std::string_view bytes) {
  Numbers numbers(bytes, Order::little_endian);
  const bool of_os2 = numbers.at(14, 4) == 12;
  ImageHeader header;
  if (of_os2)
    header = {numbers.at(18, 2), numbers.at(20, 2)};
  else  // a negative height says that the rows begin at the top
    header = {static_cast<std::int32_t>(numbers.at(18, 4)),
              std::abs(std::int64_t{static_cast<std::int32_t>(numbers.at(22, 4))})};
  return numbers.whole() ? std::optional(header) : std::nullopt;
}

/// Width and height in decimals, between white space and comments up to the end of a line.
std::optional<ImageHeader> portable(std::string_view bytes) {
  constexpr std::string_view white = " \t\r\n\v\f";
  bytes = bytes.substr(0, 4096).substr(2);
  ImageHeader header;
  for (std::int64_t* side : {&header.width, &header.height}) {
    for (;;) {
      bytes.remove_prefix(std::min(bytes.find_first_not_of(white), bytes.size()));
      if (!bytes.starts_with('#')) break;
      bytes.remove_prefix(std::min(bytes.find('\n'), bytes.size()));
    }
    const auto [end, error] = std::from_chars(bytes.data(), bytes.data() + bytes.size(), *side);
    if (error != std::errc()) return std::nullopt;
    bytes.remove_prefix(static_cast<std::size_t>(end - bytes.data()));
  }
  return header;
}

}  // namespace

std::optional<ImageHeader> read_image_header(std::string_view bytes) {
  using namespace std::string_view_literals;
  if (bytes.starts_with("\x89PNG\r\n\x1a\n"sv)) return png(bytes);
  if (bytes.starts_with("\xff\xd8\xff"sv)) return jpeg(bytes);
  if (bytes.starts_with("II*\0"sv)) return tiff(bytes, Order::little_endian);
  if (bytes.starts_with("MM\0*"sv)) return tiff(bytes, Order::big_endian);
  if (bytes.starts_with("BM"sv)) return bmp(bytes);
  const bool portable_map = bytes.size() > 2 && bytes[0] == 'P' &&
                            ((bytes[1] >= '1' && bytes[1] <= '6') || bytes[1] == 'f' || bytes[1] == 'F');
  return portable_map ? portable(bytes) : std::nullopt;
}

}  // namespace calib
