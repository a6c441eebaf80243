#include "dds/decompress.hpp"

// clang-format off: jpeglib.h needs what stdio.h declares
#include <jerror.h>
#include <jpeglib.h>
#include <png.h>
#include <cstdio>
// clang-format on

#include <algorithm>
#include <csetjmp>
#include <cstring>
#include <string>

namespace calib {
namespace {

using Bytes = std::span<const std::uint8_t>;

/// Both libraries report failure by longjmp, which leaves the locals of the function that it returns to undefined and
/// runs no destructors. What is needed after it is kept here.
struct Jpeg {
  jpeg_error_mgr error;  // first: libjpeg hands back its address, which is that of this struct
  jpeg_decompress_struct decompress;
  std::jmp_buf failed;
  char message[JMSG_LENGTH_MAX];
};

/// libjpeg keeps all coefficients of a progressive JPEG: 3 of 2 bytes each per pixel, with sides rounded up.
long jpeg_memory(ImageSize size) { return 8L * (size.width + 64) * (size.height + 64) + (16L << 20); }

bool read_jpeg(Jpeg& jpeg, Bytes bytes, ImageSize size, int channels, std::uint8_t* out) {
  jpeg_decompress_struct& from = jpeg.decompress;
  from.err = jpeg_std_error(&jpeg.error);
  jpeg.error.emit_message = [](j_common_ptr, int) {};
  jpeg.error.error_exit = [](j_common_ptr common) {
    Jpeg& failing = *reinterpret_cast<Jpeg*>(common->err);
    failing.error.format_message(common, failing.message);
    std::longjmp(failing.failed, 1);
  };
  if (setjmp(jpeg.failed) != 0) return false;
  jpeg_create_decompress(&from);
  from.mem->max_memory_to_use = jpeg_memory(size);
  jpeg_mem_src(&from, bytes.data(), bytes.size());
  jpeg_read_header(&from, TRUE);
  from.out_color_space = channels == 1 ? JCS_GRAYSCALE : JCS_RGB;
  jpeg_start_decompress(&from);
  if (from.output_width != static_cast<JDIMENSION>(size.width) ||
      from.output_height != static_cast<JDIMENSION>(size.height) || from.output_components != channels)
    return false;
  while (from.output_scanline < from.output_height) {
    JSAMPROW row = out + std::size_t{from.output_scanline} * from.output_width * static_cast<std::size_t>(channels);
    jpeg_read_scanlines(&from, &row, 1);
  }
  return true;
}

Result<void> decompress_jpeg(Bytes bytes, ImageSize size, int channels, std::uint8_t* out) {
  Jpeg jpeg{};
  const bool read = read_jpeg(jpeg, bytes, size, channels, out);
  jpeg_destroy_decompress(&jpeg.decompress);
  if (read) return {};
  if (jpeg.error.msg_code == JERR_OUT_OF_MEMORY)
    return fail(ErrorCode::out_of_memory, "there is no memory for the image");
  return fail(ErrorCode::malformed_compressed_data, std::string("it does not decode: ") + jpeg.message);
}

struct Png {
  png_structp png;
  png_infop info;
  const std::uint8_t* next;
  std::size_t left;
  char message[80];
};

void png_fails(png_structp png, png_const_charp message) {
  Png& failing = *static_cast<Png*>(png_get_error_ptr(png));
  std::strncpy(failing.message, message, sizeof failing.message - 1);
  png_longjmp(png, 1);
}

void png_warns(png_structp, png_const_charp) {}

void png_reads(png_structp png, png_bytep out, std::size_t count) {
  Png& from = *static_cast<Png*>(png_get_io_ptr(png));
  if (count > from.left) png_error(png, "the data and the pixels do not end together");
  std::memcpy(out, from.next, count);
  from.next += count;
  from.left -= count;
}

/// Reduces 16 bits to 8, drops transparency, and sorts interlaced rows.
int ask_for_pixels(const Png& from, int channels) {
  png_set_expand(from.png);
  png_set_strip_16(from.png);
  png_set_strip_alpha(from.png);
  if (channels == 3)
    png_set_gray_to_rgb(from.png);
  else if ((png_get_color_type(from.png, from.info) & PNG_COLOR_MASK_COLOR) != 0)
    png_set_rgb_to_gray(from.png, PNG_ERROR_ACTION_NONE, 0.299, 0.587);  // OpenCV's weights, as for raw images
  const int passes = png_set_interlace_handling(from.png);
  png_read_update_info(from.png, from.info);
  return passes;
}

bool read_png(Png& from, ImageSize size, int channels, std::uint8_t* out) {
  if (setjmp(png_jmpbuf(from.png)) != 0) return false;
  png_set_user_limits(from.png, static_cast<png_uint_32>(size.width), static_cast<png_uint_32>(size.height));
  png_set_chunk_malloc_max(from.png, max_png_metadata_bytes);
  png_set_chunk_cache_max(from.png, 2 * max_png_compressed_metadata);
  png_set_read_fn(from.png, &from, &png_reads);
  png_read_info(from.png, from.info);
  const int passes = ask_for_pixels(from, channels);
  const std::size_t row_bytes = static_cast<std::size_t>(size.width) * static_cast<std::size_t>(channels);
  if (png_get_rowbytes(from.png, from.info) != row_bytes ||
      png_get_image_height(from.png, from.info) != static_cast<png_uint_32>(size.height))
    return false;
  for (int pass = 0; pass < passes; ++pass)
    for (int row = 0; row < size.height; ++row) {
      // With the last row libpng decompresses the rest of the data, however much that becomes: it is limited to one
      // row.
      if (pass + 1 == passes && row + 1 == size.height)
        from.left = std::min<std::size_t>(from.left, 8 * static_cast<std::size_t>(size.width) + 16384);
      png_read_row(from.png, out + static_cast<std::size_t>(row) * row_bytes, nullptr);
    }
  return true;
}

Result<void> decompress_png(Bytes bytes, ImageSize size, int channels, std::uint8_t* out) {
  Png from{.png = nullptr, .info = nullptr, .next = bytes.data(), .left = bytes.size(), .message = {}};
  from.png = png_create_read_struct(PNG_LIBPNG_VER_STRING, &from, &png_fails, &png_warns);
  if (from.png != nullptr) from.info = png_create_info_struct(from.png);
  const bool made = from.info != nullptr;
  const bool read = made && read_png(from, size, channels, out);
  png_destroy_read_struct(&from.png, &from.info, nullptr);
  if (!made) return fail(ErrorCode::out_of_memory, "there is no memory for the image");
  if (read) return {};
  return fail(ErrorCode::malformed_compressed_data, std::string("it does not decode: ") + from.message);
}

}  // namespace

Result<void> decompress(Bytes bytes, const CompressedHeader& header, int channels, std::span<std::uint8_t> out) {
  return header.compression == Compression::jpeg ? decompress_jpeg(bytes, header.size, channels, out.data())
                                                 : decompress_png(bytes, header.size, channels, out.data());
}

}  // namespace calib
