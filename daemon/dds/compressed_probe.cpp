#include "dds/compressed_probe.hpp"

#include <algorithm>
#include <cstring>
#include <optional>
#include <string>
#include <string_view>

namespace calib {
namespace {

using Bytes = std::span<const std::uint8_t>;

std::uint32_t big_endian(Bytes bytes) {
  std::uint32_t value = 0;
  for (const std::uint8_t byte : bytes) value = value << 8 | byte;
  return value;
}

std::optional<ImageSize> in_bounds(std::int64_t width, std::int64_t height) {
  if (width < 1 || height < 1 || width > max_image_pixels || height > max_image_pixels / width) return std::nullopt;
  return ImageSize{static_cast<int>(width), static_cast<int>(height)};
}

// JPEG: markers, most with a segment of their own length, and after each start of scan its entropy-coded data.

constexpr int start_of_image = 0xD8, end_of_image = 0xD9, start_of_scan = 0xDA;

bool is_frame(int marker) {
  return marker >= 0xC0 && marker <= 0xCF && marker != 0xC4 && marker != 0xC8 && marker != 0xCC;
}

struct Segment {
  int marker = 0;
  Bytes body;
  std::size_t end = 0;  // offset of the byte after it
};

/// The segment at `at`, after any fill bytes; none if there is no marker, or the segment exceeds the data.
std::optional<Segment> jpeg_segment(Bytes bytes, std::size_t at) {
  if (at >= bytes.size() || bytes[at] != 0xFF) return std::nullopt;
  while (at < bytes.size() && bytes[at] == 0xFF) ++at;
  if (at >= bytes.size()) return std::nullopt;
  const int marker = bytes[at++];
  if (marker == end_of_image) return Segment{marker, {}, at};
  const bool bare = marker == 0 || marker == 1 || (marker >= 0xD0 && marker <= start_of_image);
  if (bare || at + 2 > bytes.size()) return std::nullopt;
  const std::size_t length = big_endian(bytes.subspan(at, 2));
  if (length < 2 || at + length > bytes.size()) return std::nullopt;
  return Segment{marker, bytes.subspan(at + 2, length - 2), at + length};
}

/// The next marker that ends a scan. Stuffed zeros, restart markers and fill bytes do not end it.
std::size_t end_of_scan(Bytes bytes, std::size_t at) {
  while (at < bytes.size()) {
    const void* found = std::memchr(bytes.data() + at, 0xFF, bytes.size() - at);
    if (found == nullptr) break;
    at = static_cast<std::size_t>(static_cast<const std::uint8_t*>(found) - bytes.data());
    if (at + 1 >= bytes.size()) break;
    const int next = bytes[at + 1];
    if (next != 0 && next != 0xFF && (next < 0xD0 || next > 0xD7)) return at;
    at += next == 0xFF ? 1 : 2;
  }
  return bytes.size();
}

/// From the first start-of-frame segment. That of a thumbnail lies within another segment and is not found.
std::optional<CompressedHeader> jpeg_header(Bytes bytes) {
  for (auto segment = jpeg_segment(bytes, 2); segment; segment = jpeg_segment(bytes, segment->end)) {
    if (segment->marker == start_of_scan || segment->marker == end_of_image) return std::nullopt;
    if (!is_frame(segment->marker)) continue;
    const Bytes frame = segment->body;
    if (frame.size() < 6) return std::nullopt;
    const auto size = in_bounds(big_endian(frame.subspan(3, 2)), big_endian(frame.subspan(1, 2)));
    if (!size) return std::nullopt;
    return CompressedHeader{Compression::jpeg, *size, frame[5] == 1 ? 1 : 3, 8};
  }
  return std::nullopt;
}

Result<void> check_jpeg(Bytes bytes) {
  int scans = 0, frames = 0;
  bool whole = false;
  std::size_t at = 2;
  while (const auto segment = jpeg_segment(bytes, at)) {
    at = segment->end;
    if (is_frame(segment->marker)) {
      // Baseline, extended and progressive with Huffman coding. The cost of others is not bounded by their size.
      const Bytes frame = segment->body;
      if (++frames > 1 || segment->marker > 0xC2 || frame.size() < 6 || frame[0] != 8 ||
          (frame[5] != 1 && frame[5] != 3))
        return fail(ErrorCode::malformed_compressed_format,
                    "a JPEG is taken with one frame of 8 bits, grey or of 3 colours, baseline or progressive, in "
                    "Huffman's code");
    } else if (segment->marker == start_of_scan) {
      ++scans;
      at = end_of_scan(bytes, at);
    } else if (segment->marker == end_of_image) {
      // Some cameras append padding or a second, smaller picture, which no decoder reads.
      whole = true;
      break;
    }
  }
  if (scans > max_jpeg_scans)
    return fail(ErrorCode::malformed_compressed_scans, "the JPEG has " + std::to_string(scans) + " scans where " +
                                                           std::to_string(max_jpeg_scans) + " are allowed");
  if (whole && frames == 1 && scans > 0) return {};
  return fail(ErrorCode::malformed_compressed_data, "the JPEG is incomplete: of " + std::to_string(bytes.size()) +
                                                        " bytes no end of image follows " + std::to_string(scans) +
                                                        " scans");
}

// PNG: a sequence of chunks, the first of which is IHDR.

struct Chunk {
  std::string_view kind;
  Bytes body;
};

std::optional<Chunk> png_chunk(Bytes bytes, std::size_t at) {
  constexpr std::size_t frame = 12;  // length, kind and checksum
  if (at + frame > bytes.size()) return std::nullopt;
  const std::size_t length = big_endian(bytes.subspan(at, 4));
  if (length > bytes.size() - at - frame) return std::nullopt;
  return Chunk{{reinterpret_cast<const char*>(bytes.data()) + at + 4, 4}, bytes.subspan(at + 8, length)};
}

constexpr std::size_t png_first_chunk = 8;

std::optional<CompressedHeader> png_header(Bytes bytes) {
  const auto chunk = png_chunk(bytes, png_first_chunk);
  if (!chunk || chunk->kind != "IHDR" || chunk->body.size() != 13) return std::nullopt;
  const auto size = in_bounds(big_endian(chunk->body.first(4)), big_endian(chunk->body.subspan(4, 4)));
  if (!size) return std::nullopt;
  const int bits = chunk->body[8], colour = chunk->body[9];
  const bool grey = colour == 0 || colour == 4;
  return CompressedHeader{Compression::png, *size, grey ? 1 : 3, bits == 16 ? 16 : 8};
}

Result<void> check_png(Bytes bytes) {
  std::size_t metadata_bytes = 0;
  int compressed_metadata = 0;
  std::size_t at = png_first_chunk;
  for (auto chunk = png_chunk(bytes, at); chunk; chunk = png_chunk(bytes, at)) {
    at += 12 + chunk->body.size();
    if (chunk->kind == "IEND") return {};
    if (chunk->kind == "acTL" || chunk->kind == "fcTL" || chunk->kind == "fdAT")
      return fail(ErrorCode::malformed_compressed_format, "the PNG is animated");
    if (chunk->kind == "IDAT") continue;
    metadata_bytes += 12 + chunk->body.size();
    compressed_metadata += chunk->kind == "iCCP" || chunk->kind == "zTXt" || chunk->kind == "iTXt";
    if (metadata_bytes > max_png_metadata_bytes || compressed_metadata > max_png_compressed_metadata)
      return fail(ErrorCode::malformed_compressed_metadata, "the PNG has more than 1 MiB of metadata, or more than " +
                                                                std::to_string(max_png_compressed_metadata) +
                                                                " compressed texts and profiles");
  }
  return fail(ErrorCode::malformed_compressed_data, "the PNG is incomplete");
}

// What else is sent as a CompressedImage.

/// `magic` at byte `at`.
struct Signature {
  std::size_t at;
  std::string_view magic, name;
};
constexpr Signature signatures[] = {
    {8, "WEBP", "WebP"},
    {4, "ftypavif", "AVIF"},
    {4, "ftyphei", "HEIF"},
    {0, std::string_view("\0\0\0\x0CJXL ", 8), "JPEG XL"},
    {0, "\xFF\x0A", "JPEG XL"},
    {0, std::string_view("\0\0\0\x0CjP  ", 8), "JPEG 2000"},
    {0, "\xFF\x4F\xFF\x51", "JPEG 2000"},
    {0, std::string_view("II*\0", 4), "TIFF"},
    {0, std::string_view("MM\0*", 4), "TIFF"},
    {0, "BM", "BMP"},
    {0, "GIF8", "GIF"},
    {0, std::string_view("\0\0\0\x01", 4), "a video stream (H.264 or H.265)"},
    {0, std::string_view("\0\0\x01", 3), "a video stream (H.264 or H.265)"},
};

/// compressed_depth_image_transport writes 12 bytes of parameters before its PNG.
constexpr std::size_t depth_parameters = 12;

tl::unexpected<Error> other_format(Bytes bytes) {
  const std::string_view text(reinterpret_cast<const char*>(bytes.data()), bytes.size());
  if (text.size() > depth_parameters && compression_of(bytes.subspan(depth_parameters)) == Compression::png)
    return fail(ErrorCode::malformed_depth_encoding,
                "a PNG follows 12 bytes of parameters: this is a compressed depth image; configure the camera's image "
                "topic");
  std::string what = "data begins neither as a JPEG nor as a PNG";
  const auto* const known = std::ranges::find_if(signatures, [&](const Signature& signature) {
    return text.size() >= signature.at && text.substr(signature.at).starts_with(signature.magic);
  });
  if (known != std::end(signatures)) what += ", but as " + std::string(known->name);
  return fail(ErrorCode::malformed_compressed_format, std::move(what));
}

}  // namespace

Result<CompressedHeader> probe_compressed(Bytes bytes) {
  const auto compression = compression_of(bytes);
  if (!compression) return other_format(bytes);
  const auto header = *compression == Compression::jpeg ? jpeg_header(bytes) : png_header(bytes);
  if (!header) return fail(ErrorCode::malformed_compressed_dimensions, "its header gives no size in 1 .. 64 Mpx");
  return *header;
}

Result<void> check_compressed(Bytes bytes, const CompressedHeader& header) {
  return header.compression == Compression::jpeg ? check_jpeg(bytes) : check_png(bytes);
}

}  // namespace calib
