#include "calib/image_codec.hpp"

#include <png.h>

#include <algorithm>
#include <cstring>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <string>
#include <vector>

#include "support/catch.hpp"
#include "support/support.hpp"

using namespace calib;
using Catch::Matchers::ContainsSubstring;
using test::require_ok;

namespace {

using Octets = std::vector<std::uint8_t>;

constexpr int width = 65, height = 33;

/// Edges and noise, so that a wrong channel or rounding cannot pass.
cv::Mat scene(int type) {
  cv::Mat scene(height, width, type);
  cv::RNG(7).fill(scene, cv::RNG::UNIFORM, 0, CV_MAT_DEPTH(type) == CV_16U ? 65536 : 256);
  cv::rectangle(scene, {10, 8, 30, 15}, cv::Scalar(20, 90, 230, 255), cv::FILLED);
  return scene;
}

Octets encoded(const std::string& extension, const cv::Mat& pixels, const std::vector<int>& how = {}) {
  Octets bytes;
  REQUIRE(cv::imencode(extension, pixels, bytes, how));
  return bytes;
}

/// A PNG of any kind, of random bits; OpenCV writes only some.
Octets png_of(int colour_type, int bits, int interlace, bool with_transparency = false) {
  Octets file, bits_of_row;
  png_structp png = png_create_write_struct(PNG_LIBPNG_VER_STRING, nullptr, nullptr, nullptr);
  png_infop info = png_create_info_struct(png);
  png_set_write_fn(
      png, &file,
      [](png_structp to, png_bytep bytes, std::size_t count) {
        auto& out = *static_cast<Octets*>(png_get_io_ptr(to));
        out.insert(out.end(), bytes, bytes + count);
      },
      nullptr);
  png_set_IHDR(png, info, width, height, bits, colour_type, interlace, PNG_COMPRESSION_TYPE_DEFAULT,
               PNG_FILTER_TYPE_DEFAULT);
  cv::RNG random(11);
  std::vector<png_color> palette(colour_type == PNG_COLOR_TYPE_PALETTE ? std::size_t{1} << bits : 0);
  for (png_color& colour : palette)
    colour = {static_cast<png_byte>(random.uniform(0, 256)), static_cast<png_byte>(random.uniform(0, 256)),
              static_cast<png_byte>(random.uniform(0, 256))};
  if (!palette.empty()) png_set_PLTE(png, info, palette.data(), static_cast<int>(palette.size()));
  const Octets alpha{0, 128};
  png_color_16 transparent{};
  if (with_transparency) png_set_tRNS(png, info, alpha.data(), palette.empty() ? 0 : 2, &transparent);
  png_write_info(png, info);
  bits_of_row.resize(png_get_rowbytes(png, info));
  std::vector<Octets> rows(height, bits_of_row);
  std::vector<png_bytep> places;
  for (Octets& row : rows) {
    for (std::uint8_t& octet : row) octet = static_cast<std::uint8_t>(random.uniform(0, 256));
    places.push_back(row.data());
  }
  png_write_image(png, places.data());
  png_write_end(png, nullptr);
  png_destroy_write_struct(&png, &info);
  return file;
}

Result<Octets> decode(const Octets& file, int channels, int of_width = width, int of_height = height) {
  const PixelLayout layout{of_width, of_height, channels};
  Octets pixels(layout.bytes());
  const auto compression = compression_of(file);
  REQUIRE(compression);
  const auto decoded = decode_pixels(file, *compression, layout, pixels);
  if (!decoded) return propagate(decoded);
  return pixels;
}

void check_equals_opencv(const Octets& file) {
  const cv::Mat grey = cv::imdecode(file, cv::IMREAD_GRAYSCALE), bgr = cv::imdecode(file, cv::IMREAD_COLOR);
  REQUIRE(grey.size() == cv::Size(width, height));
  const Octets in_grey = require_ok(decode(file, 1)), in_colour = require_ok(decode(file, 3));
  CHECK(std::equal(in_grey.begin(), in_grey.end(), grey.data));
  cv::Mat rgb;
  cv::cvtColor(bgr, rgb, cv::COLOR_BGR2RGB);
  CHECK(std::equal(in_colour.begin(), in_colour.end(), rgb.data));
}

}  // namespace

TEST_CASE("pixels of a JPEG equal those of OpenCV's decoder, grey and in colour") {
  for (const int type : {CV_8UC1, CV_8UC3})
    for (const int progressive : {0, 1})
      for (const int quality : {50, 100})
        check_equals_opencv(encoded(".jpg", scene(type),
                                    {cv::IMWRITE_JPEG_PROGRESSIVE, progressive, cv::IMWRITE_JPEG_QUALITY, quality}));
}

TEST_CASE("pixels of a PNG equal those of OpenCV's decoder, of every colour type and depth, grey and in colour") {
  const std::vector<std::pair<int, std::vector<int>>> kinds{{PNG_COLOR_TYPE_GRAY, {1, 2, 4, 8, 16}},
                                                            {PNG_COLOR_TYPE_PALETTE, {1, 2, 4, 8}},
                                                            {PNG_COLOR_TYPE_GRAY_ALPHA, {8, 16}},
                                                            {PNG_COLOR_TYPE_RGB, {8, 16}},
                                                            {PNG_COLOR_TYPE_RGB_ALPHA, {8, 16}}};
  for (const auto& [colour_type, depths] : kinds)
    for (const int bits : depths)
      for (const int interlace : {PNG_INTERLACE_NONE, PNG_INTERLACE_ADAM7}) {
        INFO("colour type " << colour_type << " of " << bits << " bits, interlace " << interlace);
        check_equals_opencv(png_of(colour_type, bits, interlace));
        if ((colour_type & PNG_COLOR_MASK_ALPHA) == 0) check_equals_opencv(png_of(colour_type, bits, interlace, true));
      }
}

TEST_CASE("what is encoded decodes again: a PNG to the same pixels, a JPEG to nearly the same") {
  for (const int type : {CV_8UC1, CV_8UC3}) {
    const cv::Mat pixels = scene(type);
    cv::Mat smooth;
    cv::blur(pixels, smooth, {15, 15});
    for (const cv::Mat& picture : {pixels, smooth}) {
      const PixelLayout layout{width, height, picture.channels()};
      const std::span<const std::uint8_t> bytes(picture.data, layout.bytes());
      const std::string png = require_ok(encode_pixels(bytes, layout, Compression::png));
      CHECK(std::ranges::equal(require_ok(decode({png.begin(), png.end()}, layout.channels)), bytes));
    }
    const PixelLayout layout{width, height, smooth.channels()};
    const std::string jpeg = require_ok(encode_pixels({smooth.data, layout.bytes()}, layout, Compression::jpeg));
    const Octets again = require_ok(decode({jpeg.begin(), jpeg.end()}, layout.channels));
    const cv::Mat got(height, width, type, const_cast<std::uint8_t*>(again.data()));
    CHECK(cv::norm(got, smooth, cv::NORM_L1) / static_cast<double>(layout.bytes()) < 3);
  }
}

TEST_CASE("a file is recognised by its first bytes") {
  CHECK(compression_of(encoded(".jpg", scene(CV_8UC1))) == Compression::jpeg);
  CHECK(compression_of(encoded(".png", scene(CV_8UC1))) == Compression::png);
  for (const char* extension : {".bmp", ".pgm", ".tiff"})
    CHECK_FALSE(compression_of(encoded(extension, scene(CV_8UC1))));
  const Octets png = encoded(".png", scene(CV_8UC1));
  for (std::size_t size = 0; size < 8; ++size) CHECK_FALSE(compression_of({png.data(), size}));
}

TEST_CASE("what breaks off, is damaged or has another size is refused") {
  for (const char* extension : {".png", ".jpg"}) {
    const Octets good = encoded(extension, scene(CV_8UC3));
    for (const auto& [of_width, of_height] : {std::pair{width, height - 1}, {width, height + 1}, {width - 1, height}})
      CHECK_FALSE(decode(good, 3, of_width, of_height));
    const auto headless = decode({good.begin(), good.begin() + 20}, 3);
    REQUIRE_FALSE(headless);
    CHECK(headless.error().code == ErrorCode::malformed_compressed_data);
    CHECK_THAT(headless.error().context, ContainsSubstring("it does not decode: "));
  }
  const Octets png = encoded(".png", scene(CV_8UC3));
  CHECK_FALSE(decode({png.begin(), png.end() - 40}, 3));
  Octets damaged = png;
  damaged[damaged.size() / 2] ^= 1;
  CHECK_FALSE(decode(damaged, 3));
}

TEST_CASE("a picture that is too large for its format is not encoded, and the library's reason is given") {
  const PixelLayout wide{65'501, 1, 1};
  const Octets row(wide.bytes(), 7);
  const auto refused = encode_pixels(row, wide, Compression::jpeg);
  REQUIRE_FALSE(refused);
  CHECK(refused.error().code == ErrorCode::write_failed);
  CHECK_THAT(refused.error().context, ContainsSubstring("65500"));
  CHECK(encode_pixels(row, wide, Compression::png));
  CHECK_FALSE(encode_pixels({}, {0, 0, 3}, Compression::png));
  CHECK_FALSE(encode_pixels({}, {0, 0, 3}, Compression::jpeg));
}
