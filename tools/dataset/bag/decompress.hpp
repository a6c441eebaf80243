#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <string>

#include "dataset/bag/byte_source.hpp"

namespace calib {

struct Decompressed {
  Octets bytes;
  /// Whether that is all there was: the input ended where it should, and nothing in it was damaged.
  bool complete = false;
};

/// What can be decompressed of frames of Zstandard (RFC 8878) or LZ4; `most` bytes at most. Memory grows with what is
/// written, whatever the input promises.
[[nodiscard]] Decompressed decompress_zstd(std::span<const std::uint8_t> in, std::uint64_t most);
[[nodiscard]] Decompressed decompress_lz4(std::span<const std::uint8_t> in, std::uint64_t most);

/// Whether bytes begin as a frame of Zstandard does.
[[nodiscard]] bool is_zstd(std::span<const std::uint8_t> bytes);

/// A message as its writer had it, who may have compressed it. Fails with `file_unreadable` where it is damaged.
[[nodiscard]] Result<Octets> plain_message(Octets bytes, std::uint64_t most, const std::string& source);

struct DecompressedFile {
  std::unique_ptr<TemporaryFile> file;
  bool complete = false;
};
/// Likewise of a whole file, into a new file in $TMPDIR (or /tmp), which at least 256 MiB are left free in. Fails with
/// `write_failed`.
[[nodiscard]] Result<DecompressedFile> decompress_zstd_file(const ByteSource& in);

}  // namespace calib
