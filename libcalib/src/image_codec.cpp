#include "calib/image_codec.hpp"

// clang-format off: jpeglib.h needs what stdio.h declares
#include <jerror.h>
#include <jpeglib.h>
#include <png.h>
#include <cstdio>
// clang-format on

#include <algorithm>
#include <csetjmp>
#include <cstdlib>
#include <cstring>
#include <utility>

namespace calib {
namespace {

using Bytes = std::span<const std::uint8_t>;

constexpr const char* no_memory = "there is no memory for the image";

// Both libraries report failure by longjmp, which leaves the locals of the function that it returns to undefined and
// runs no destructors. What is needed after it is kept in structs of the caller.

struct JpegErrors {
  jpeg_error_mgr manager;  // first: libjpeg hands back its address, which is that of this struct
  std::jmp_buf failed;
  char message[JMSG_LENGTH_MAX];
};

/// What libjpeg is to report to. Warnings are dropped.
jpeg_error_mgr* report_to(JpegErrors& errors) {
  jpeg_std_error(&errors.manager);
  errors.manager.emit_message = [](j_common_ptr, int) {};
  errors.manager.error_exit = [](j_common_ptr common) {
    JpegErrors& failing = *reinterpret_cast<JpegErrors*>(common->err);
    failing.manager.format_message(common, failing.message);
    std::longjmp(failing.failed, 1);
  };
  return &errors.manager;
}

struct Png {
  png_structp png;
  png_infop info;
  char message[80];
};

void png_fails(png_structp png, png_const_charp message) {
  Png& failing = *static_cast<Png*>(png_get_error_ptr(png));
  std::strncpy(failing.message, message, sizeof failing.message - 1);
  png_longjmp(png, 1);
}

void png_warns(png_structp, png_const_charp) {}

// Decoding.

struct JpegReader {
  JpegErrors errors;
  jpeg_decompress_struct decompress;
};

/// libjpeg keeps all coefficients of a progressive JPEG: 3 of 2 bytes each per pixel, with sides rounded up.
long jpeg_memory(const PixelLayout& layout) { return 8L * (layout.width + 64) * (layout.height + 64) + (16L << 20); }

bool read_jpeg(JpegReader& jpeg, Bytes bytes, const PixelLayout& layout, std::uint8_t* out) {
  jpeg_decompress_struct& from = jpeg.decompress;
  from.err = report_to(jpeg.errors);
  if (setjmp(jpeg.errors.failed) != 0) return false;
  jpeg_create_decompress(&from);
  from.mem->max_memory_to_use = jpeg_memory(layout);
  jpeg_mem_src(&from, bytes.data(), bytes.size());
  jpeg_read_header(&from, TRUE);
  from.out_color_space = layout.channels == 1 ? JCS_GRAYSCALE : JCS_RGB;
  jpeg_start_decompress(&from);
  if (from.output_width != static_cast<JDIMENSION>(layout.width) ||
      from.output_height != static_cast<JDIMENSION>(layout.height) || from.output_components != layout.channels)
    return false;
  while (from.output_scanline < from.output_height) {
    JSAMPROW row = out + from.output_scanline * layout.row_bytes();
    jpeg_read_scanlines(&from, &row, 1);
  }
  return true;
}

Result<void> decode_jpeg(Bytes bytes, const PixelLayout& layout, std::uint8_t* out) {
  JpegReader jpeg{};
  const bool read = read_jpeg(jpeg, bytes, layout, out);
  jpeg_destroy_decompress(&jpeg.decompress);
  if (read) return {};
  if (jpeg.errors.manager.msg_code == JERR_OUT_OF_MEMORY) return fail(ErrorCode::out_of_memory, no_memory);
  return fail(ErrorCode::malformed_compressed_data, std::string("it does not decode: ") + jpeg.errors.message);
}

void png_reads(png_structp png, png_bytep out, std::size_t count) {
  Bytes& left = *static_cast<Bytes*>(png_get_io_ptr(png));
  if (count > left.size()) png_error(png, "the data and the pixels do not end together");
  std::memcpy(out, left.data(), count);
  left = left.subspan(count);
}

/// Reduces 16 bits to 8 unless they are wanted, drops transparency, and sorts interlaced rows.
int ask_for_pixels(const Png& from, const PixelLayout& layout) {
  const int channels = layout.channels;
  png_set_expand(from.png);
  if (!layout.words) png_set_strip_16(from.png);
  png_set_strip_alpha(from.png);
  if (channels == 3)
    png_set_gray_to_rgb(from.png);
  else if ((png_get_color_type(from.png, from.info) & PNG_COLOR_MASK_COLOR) != 0)
    png_set_rgb_to_gray(from.png, PNG_ERROR_ACTION_NONE, 0.299, 0.587);  // OpenCV's weights, as for raw images
  const int passes = png_set_interlace_handling(from.png);
  png_read_update_info(from.png, from.info);
  return passes;
}

bool read_png(Png& from, Bytes& left, const PixelLayout& layout, std::uint8_t* out) {
  constexpr png_alloc_size_t most_of_a_chunk = 1 << 20;
  constexpr int most_kept_chunks = 8;
  if (setjmp(png_jmpbuf(from.png)) != 0) return false;
  png_set_user_limits(from.png, static_cast<png_uint_32>(layout.width), static_cast<png_uint_32>(layout.height));
  png_set_chunk_malloc_max(from.png, most_of_a_chunk);
  png_set_chunk_cache_max(from.png, most_kept_chunks);
  png_set_read_fn(from.png, &left, &png_reads);
  png_read_info(from.png, from.info);
  const int passes = ask_for_pixels(from, layout);
  if (png_get_rowbytes(from.png, from.info) != layout.row_bytes() ||
      png_get_image_height(from.png, from.info) != static_cast<png_uint_32>(layout.height))
    return false;
  for (int pass = 0; pass < passes; ++pass)
    for (int row = 0; row < layout.height; ++row) {
      // With the last row libpng decompresses the rest of the data, however much that becomes: it is limited to one
      // row.
      if (pass + 1 == passes && row + 1 == layout.height)
        left = left.first(std::min(left.size(), 8 * static_cast<std::size_t>(layout.width) + 16384));
      png_read_row(from.png, out + row * layout.row_bytes(), nullptr);
    }
  return true;
}

Result<void> decode_png(Bytes bytes, const PixelLayout& layout, std::uint8_t* out) {
  Png from{};
  from.png = png_create_read_struct(PNG_LIBPNG_VER_STRING, &from, &png_fails, &png_warns);
  if (from.png != nullptr) from.info = png_create_info_struct(from.png);
  const bool made = from.info != nullptr;
  const bool read = made && read_png(from, bytes, layout, out);
  png_destroy_read_struct(&from.png, &from.info, nullptr);
  if (!made) return fail(ErrorCode::out_of_memory, no_memory);
  if (read) return {};
  return fail(ErrorCode::malformed_compressed_data, std::string("it does not decode: ") + from.message);
}

// Encoding.

/// A file in memory for libraries that write to a FILE: their failure to write comes as one of their errors.
class MemoryFile {
 public:
  MemoryFile() : file_(open_memstream(&bytes_, &size_)) {}
  MemoryFile(const MemoryFile&) = delete;
  MemoryFile& operator=(const MemoryFile&) = delete;
  ~MemoryFile() {
    static_cast<void>(close());
    std::free(bytes_);
  }

  /// Null when there is no memory.
  [[nodiscard]] FILE* file() const { return file_; }
  /// Whether all that was written is in `content`.
  [[nodiscard]] bool close() {
    FILE* const file = std::exchange(file_, nullptr);
    return file != nullptr && std::fclose(file) == 0;
  }
  [[nodiscard]] std::string content() const { return {bytes_, size_}; }

 private:
  char* bytes_ = nullptr;
  std::size_t size_ = 0;
  FILE* file_;  // after what it fills
};

struct JpegWriter {
  JpegErrors errors;
  jpeg_compress_struct compress;
};

bool write_jpeg(JpegWriter& jpeg, FILE* file, const PixelLayout& layout, const std::uint8_t* pixels) {
  jpeg_compress_struct& to = jpeg.compress;
  to.err = report_to(jpeg.errors);
  if (setjmp(jpeg.errors.failed) != 0) return false;
  jpeg_create_compress(&to);
  jpeg_stdio_dest(&to, file);
  to.image_width = static_cast<JDIMENSION>(layout.width);
  to.image_height = static_cast<JDIMENSION>(layout.height);
  to.input_components = layout.channels;
  to.in_color_space = layout.channels == 1 ? JCS_GRAYSCALE : JCS_RGB;
  jpeg_set_defaults(&to);
  jpeg_set_quality(&to, 95, TRUE);
  jpeg_start_compress(&to, TRUE);
  while (to.next_scanline < to.image_height) {
    auto* row = const_cast<JSAMPLE*>(pixels + to.next_scanline * layout.row_bytes());  // libjpeg only reads it
    jpeg_write_scanlines(&to, &row, 1);
  }
  jpeg_finish_compress(&to);
  return true;
}

bool write_png(Png& to, FILE* file, const PixelLayout& layout, const std::uint8_t* pixels) {
  constexpr int fastest = 1;  // of zlib's levels
  if (setjmp(png_jmpbuf(to.png)) != 0) return false;
  png_init_io(to.png, file);
  png_set_IHDR(to.png, to.info, static_cast<png_uint_32>(layout.width), static_cast<png_uint_32>(layout.height), 8,
               layout.channels == 1 ? PNG_COLOR_TYPE_GRAY : PNG_COLOR_TYPE_RGB, PNG_INTERLACE_NONE,
               PNG_COMPRESSION_TYPE_DEFAULT, PNG_FILTER_TYPE_DEFAULT);
  png_set_compression_level(to.png, fastest);
  png_set_filter(to.png, PNG_FILTER_TYPE_BASE, PNG_FILTER_SUB);
  png_write_info(to.png, to.info);
  for (int row = 0; row < layout.height; ++row) png_write_row(to.png, pixels + row * layout.row_bytes());
  png_write_end(to.png, nullptr);
  return true;
}

Result<void> encode_jpeg(const PixelLayout& layout, const std::uint8_t* pixels, FILE* file) {
  JpegWriter jpeg{};
  const bool written = write_jpeg(jpeg, file, layout, pixels);
  jpeg_destroy_compress(&jpeg.compress);
  if (written) return {};
  return fail(ErrorCode::write_failed, std::string("it cannot be encoded: ") + jpeg.errors.message);
}

Result<void> encode_png(const PixelLayout& layout, const std::uint8_t* pixels, FILE* file) {
  Png to{};
  to.png = png_create_write_struct(PNG_LIBPNG_VER_STRING, &to, &png_fails, &png_warns);
  if (to.png != nullptr) to.info = png_create_info_struct(to.png);
  const bool made = to.info != nullptr;
  const bool written = made && write_png(to, file, layout, pixels);
  png_destroy_write_struct(&to.png, &to.info);
  if (!made) return fail(ErrorCode::write_failed, no_memory);
  if (written) return {};
  return fail(ErrorCode::write_failed, std::string("it cannot be encoded: ") + to.message);
}

}  // namespace

std::optional<Compression> compression_of(Bytes bytes) {
  constexpr std::uint8_t jpeg[] = {0xFF, 0xD8, 0xFF};
  constexpr std::uint8_t png[] = {0x89, 'P', 'N', 'G', '\r', '\n', 0x1A, '\n'};
  const auto begin_as = [&](Bytes magic) {
    return bytes.size() >= magic.size() && std::ranges::equal(bytes.first(magic.size()), magic);
  };
  if (begin_as(jpeg)) return Compression::jpeg;
  if (begin_as(png)) return Compression::png;
  return std::nullopt;
}

Result<void> decode_pixels(Bytes bytes, Compression compression, const PixelLayout& layout,
                           std::span<std::uint8_t> out) {
  return compression == Compression::jpeg ? decode_jpeg(bytes, layout, out.data())
                                          : decode_png(bytes, layout, out.data());
}

Result<std::string> encode_pixels(Bytes pixels, const PixelLayout& layout, Compression compression) {
  MemoryFile memory;
  if (memory.file() == nullptr) return fail(ErrorCode::write_failed, no_memory);
  const auto encoded = compression == Compression::jpeg ? encode_jpeg(layout, pixels.data(), memory.file())
                                                        : encode_png(layout, pixels.data(), memory.file());
  if (!encoded) return propagate(encoded);
  if (!memory.close()) return fail(ErrorCode::write_failed, no_memory);
  return memory.content();
}

}  // namespace calib
