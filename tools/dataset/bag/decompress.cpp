#include "dataset/bag/decompress.hpp"

#include <lz4frame.h>
#include <sys/statvfs.h>
#include <unistd.h>
#include <zstd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <string>
#include <system_error>

namespace calib {
namespace {

using ZstdContext = std::unique_ptr<ZSTD_DCtx, decltype(&ZSTD_freeDCtx)>;
constexpr std::size_t first_size = 64 * 1024;

/// Doubles what there is room for, up to `most`; false when there is no more.
bool grow(Octets& bytes, std::uint64_t most) {
  if (bytes.size() >= most) return false;
  bytes.resize(std::min<std::uint64_t>(most, std::max<std::uint64_t>(first_size, 2 * bytes.size())));
  return true;
}

bool write_all(int descriptor, std::span<const std::uint8_t> bytes) {
  while (!bytes.empty()) {
    const ssize_t written = ::write(descriptor, bytes.data(), bytes.size());
    if (written < 0 && errno != EINTR) return false;
    if (written > 0) bytes = bytes.subspan(static_cast<std::size_t>(written));
  }
  return true;
}

bool has_room(int descriptor) {
  constexpr std::uint64_t left_free = 256 << 20;
  struct statvfs facts {};
  return ::fstatvfs(descriptor, &facts) != 0 || std::uint64_t{facts.f_bavail} * facts.f_frsize > left_free;
}

}  // namespace

bool is_zstd(std::span<const std::uint8_t> bytes) {
  constexpr std::array<std::uint8_t, 4> magic{0x28, 0xB5, 0x2F, 0xFD};
  return bytes.size() >= magic.size() && std::ranges::equal(bytes.first(magic.size()), magic);
}

Decompressed decompress_zstd(std::span<const std::uint8_t> in, std::uint64_t most) {
  const ZstdContext context(ZSTD_createDCtx(), ZSTD_freeDCtx);
  if (!context) throw std::bad_alloc();
  Decompressed result;
  ZSTD_inBuffer from{in.data(), in.size(), 0};
  std::size_t filled = 0, wanted = 1;
  while (true) {
    if (filled == result.bytes.size() && !grow(result.bytes, most)) {
      // Nothing may come after what was asked for, but the end of the frame.
      std::uint8_t spare = 0;
      ZSTD_outBuffer none{&spare, 1, 0};
      if (wanted != 0) wanted = ZSTD_decompressStream(context.get(), &none, &from);
      result.complete = wanted == 0 && none.pos == 0 && from.pos == from.size;
      break;
    }
    ZSTD_outBuffer to{result.bytes.data(), result.bytes.size(), filled};
    const std::size_t taken = from.pos;
    wanted = ZSTD_decompressStream(context.get(), &to, &from);
    const bool stuck = to.pos == filled && from.pos == taken;
    filled = to.pos;
    if (ZSTD_isError(wanted) != 0 || stuck) break;
    if (wanted == 0 && from.pos == from.size) {
      result.complete = true;
      break;
    }
    if (from.pos == from.size && filled < result.bytes.size()) break;  // cut short
  }
  result.bytes.resize(filled);
  return result;
}

Decompressed decompress_lz4(std::span<const std::uint8_t> in, std::uint64_t most) {
  LZ4F_dctx* made = nullptr;
  if (LZ4F_isError(LZ4F_createDecompressionContext(&made, LZ4F_VERSION)) != 0) throw std::bad_alloc();
  const std::unique_ptr<LZ4F_dctx, decltype(&LZ4F_freeDecompressionContext)> context(made,
                                                                                     LZ4F_freeDecompressionContext);
  Decompressed result;
  std::size_t filled = 0;
  while (true) {
    std::uint8_t spare = 0;
    const bool full = filled == result.bytes.size() && !grow(result.bytes, most);
    std::size_t room = full ? 1 : result.bytes.size() - filled, taken = in.size();
    const std::size_t wanted =
        LZ4F_decompress(context.get(), full ? &spare : result.bytes.data() + filled, &room, in.data(), &taken, nullptr);
    if (LZ4F_isError(wanted) != 0) break;
    in = in.subspan(taken);
    if (full && room > 0) break;
    filled += full ? 0 : room;
    result.complete = wanted == 0 && in.empty();
    if (result.complete || (taken == 0 && room == 0)) break;
  }
  result.bytes.resize(filled);
  return result;
}

Result<Octets> plain_message(Octets bytes, std::uint64_t most, const std::string& source) {
  if (!is_zstd(bytes)) return bytes;
  Decompressed plain = decompress_zstd(bytes, most);
  if (!plain.complete) return fail(ErrorCode::file_unreadable, "a compressed message of " + source + " is damaged");
  return std::move(plain.bytes);
}

Result<DecompressedFile> decompress_zstd_file(const ByteSource& in) {
  std::error_code error;
  const auto folder = std::filesystem::temp_directory_path(error);
  std::string name = (folder / "calibd-bag-XXXXXX").string();
  const int descriptor = ::mkstemp(name.data());
  const auto failed = [&name](const std::string& why) {
    return fail(ErrorCode::write_failed, "the recording cannot be decompressed into " + name + ": " + why +
                                             "; set TMPDIR to a folder with more room, or decompress it with zstd");
  };
  if (descriptor < 0 && error) return failed(error.message());
  if (descriptor < 0) return failed(std::error_code(errno, std::generic_category()).message());
  DecompressedFile result{std::make_unique<TemporaryFile>(name), false};
  const std::unique_ptr<const int, void (*)(const int*)> closing(&descriptor, [](const int* open) { ::close(*open); });

  const ZstdContext context(ZSTD_createDCtx(), ZSTD_freeDCtx);
  if (!context) throw std::bad_alloc();
  Octets read(ZSTD_DStreamInSize()), written(ZSTD_DStreamOutSize());
  std::size_t wanted = 1;
  for (std::uint64_t at = 0; at < in.size();) {
    const std::span<std::uint8_t> piece(read.data(), std::min<std::uint64_t>(read.size(), in.size() - at));
    if (!in.read(at, piece)) return result;
    at += piece.size();
    ZSTD_inBuffer from{piece.data(), piece.size(), 0};
    // Also while there is output left that did not fit.
    for (bool more = true; more;) {
      ZSTD_outBuffer to{written.data(), written.size(), 0};
      wanted = ZSTD_decompressStream(context.get(), &to, &from);
      if (ZSTD_isError(wanted) != 0) return result;
      if (!has_room(descriptor)) return failed("there is no room left");
      if (!write_all(descriptor, {written.data(), to.pos}))
        return failed(std::error_code(errno, std::generic_category()).message());
      more = from.pos < from.size || to.pos == to.size;
    }
  }
  result.complete = wanted == 0;
  return result;
}

}  // namespace calib
