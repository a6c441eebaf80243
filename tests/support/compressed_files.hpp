#pragma once

#include <zlib.h>

#include <string_view>

#include "support/ros_messages.hpp"

namespace calib::test {

/// JPEGs and PNGs made by hand, such as no encoder would make them.

inline void put(Octets& out, std::initializer_list<int> bytes) {
  for (const int byte : bytes) out.push_back(static_cast<std::uint8_t>(byte));
}

/// One colour, with the first scan's few bits and `scans - 1` refinements without any: libjpeg goes over all blocks for
/// each of them. `frame` is the marker of its frame.
inline Octets jpeg_of_scans(int width, int height, int scans, int frame = 0xC2) {
  Octets out;
  put(out, {0xFF, 0xD8, 0xFF, 0xDB, 0, 67, 0});
  out.insert(out.end(), 64, 1);  // quantisation
  put(out, {0xFF, frame, 0, 11, 8, height >> 8, height & 255, width >> 8, width & 255, 1, 1, 0x11, 0});
  for (const int table : {0x00, 0x10}) {  // Huffman: one code of one bit, for 0
    put(out, {0xFF, 0xC4, 0, 20, table, 1});
    out.insert(out.end(), 16, 0);
  }
  const int first_bit = frame == 0xC2 ? 0x01 : 0x00, last = frame == 0xC2 ? 0 : 63;
  put(out, {0xFF, 0xDA, 0, 8, 1, 1, 0x00, 0, last, first_bit, 0, 0, 0, 0});
  for (int scan = 1; scan < scans; ++scan) put(out, {0xFF, 0xDA, 0, 8, 1, 1, 0x00, 1, 63, 0x10, 0});
  put(out, {0xFF, 0xD9});
  return out;
}

inline void put_chunk(Octets& out, std::string_view kind, const Octets& body) {
  const auto put_32 = [&](std::uint32_t value) {
    for (int shift = 24; shift >= 0; shift -= 8) out.push_back(static_cast<std::uint8_t>(value >> shift));
  };
  put_32(static_cast<std::uint32_t>(body.size()));
  const std::size_t begin = out.size();
  out.insert(out.end(), kind.begin(), kind.end());
  out.insert(out.end(), body.begin(), body.end());
  put_32(static_cast<std::uint32_t>(crc32(0, out.data() + begin, static_cast<uInt>(out.size() - begin))));
}

inline Octets deflated(std::size_t zeros) {
  const Octets raw(zeros, 0);
  Octets out(compressBound(raw.size()));
  uLongf size = out.size();
  compress2(out.data(), &size, raw.data(), raw.size(), 9);
  out.resize(size);
  return out;
}

/// A black 8-bit grey PNG, with `extra` chunks before its pixels, and pixels for `rows` rows.
inline Octets black_png(int width, int height, int rows,
                        const std::vector<std::pair<std::string, Octets>>& extra = {}) {
  Octets out{0x89, 'P', 'N', 'G', '\r', '\n', 0x1A, '\n'}, header;
  put(header,
      {width >> 24, width >> 16, width >> 8, width, height >> 24, height >> 16, height >> 8, height, 8, 0, 0, 0, 0});
  put_chunk(out, "IHDR", header);
  for (const auto& [kind, body] : extra) put_chunk(out, kind, body);
  put_chunk(out, "IDAT", deflated(static_cast<std::size_t>(rows) * (1 + static_cast<std::size_t>(width))));
  put_chunk(out, "IEND", {});
  return out;
}

}  // namespace calib::test
