#include <algorithm>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <tuple>

#include "dds/decode.hpp"
#include "support/catch.hpp"
#include "support/ros_messages.hpp"
#include "support/support.hpp"

// Images as drivers and image_transport are known to publish them, each a case of a public report.

using namespace calib;
using namespace calib::test;

namespace {

Result<Image> decode(ImageMessage& message) { return decode_image(message.raw(), Colour::rgb); }
Result<Image> decode(CompressedImageMessage& message) { return decode_compressed_image(message.raw(), Colour::rgb); }

cv::Mat colour_scene(int width, int height) {
  cv::Mat scene(height, width, CV_8UC3);
  cv::RNG random(7);
  random.fill(scene, cv::RNG::UNIFORM, 0, 256);
  return scene;
}

/// Rows of `pixels` in rows of `step` bytes.
ImageMessage image_message(const cv::Mat& pixels, const std::string& encoding, std::size_t step = 0) {
  ImageMessage message;
  const std::size_t row_bytes = static_cast<std::size_t>(pixels.cols) * pixels.elemSize();
  message.width = static_cast<std::uint32_t>(pixels.cols);
  message.height = static_cast<std::uint32_t>(pixels.rows);
  message.step = static_cast<std::uint32_t>(std::max(step, row_bytes));
  message.encoding = encoding;
  message.data.assign(std::size_t{message.step} * message.height, 0xEE);
  for (int row = 0; row < pixels.rows; ++row)
    std::copy_n(pixels.ptr(row), row_bytes, message.data.data() + row * message.step);
  return message;
}

cv::Mat grey_of(const cv::Mat& bgr) {
  cv::Mat grey;
  cv::cvtColor(bgr, grey, cv::COLOR_BGR2GRAY);
  return grey;
}

int largest_difference(const Image& image, const cv::Mat& expected) {
  REQUIRE(image.width == expected.cols);
  REQUIRE(image.height == expected.rows);
  const cv::Mat got(image.height, image.width, CV_8UC1, const_cast<std::uint8_t*>(image.pixels.data()));
  return static_cast<int>(cv::norm(got, expected, cv::NORM_INF));
}

CompressedImageMessage compressed(const std::string& extension, const cv::Mat& pixels, const std::string& format) {
  CompressedImageMessage message;
  message.format = format;
  REQUIRE(cv::imencode(extension, pixels, message.data));
  return message;
}

/// BGGR, row after row.
cv::Mat mosaic(const cv::Mat& scene) {
  cv::Mat raw(scene.rows, scene.cols, CV_8UC1);
  for (int y = 0; y < scene.rows; ++y)
    for (int x = 0; x < scene.cols; ++x) raw.at<std::uint8_t>(y, x) = scene.at<cv::Vec3b>(y, x)[y % 2 + x % 2];
  return raw;
}

}  // namespace

TEST_CASE("8UC4, 16UC4, rgba16 and bgra16 are four channels, in OpenCV's order where the name has none") {
  const cv::Mat bgr = colour_scene(22, 14);
  for (const auto& [encoding, conversion, deep] :
       std::vector<std::tuple<std::string, int, bool>>{{"8UC4", cv::COLOR_BGR2BGRA, false},
                                                       {"16UC4", cv::COLOR_BGR2BGRA, true},
                                                       {"bgra16", cv::COLOR_BGR2BGRA, true},
                                                       {"rgba16", cv::COLOR_BGR2RGBA, true}}) {
    INFO(encoding);
    cv::Mat pixels;
    cv::cvtColor(bgr, pixels, conversion);
    if (deep) pixels.convertTo(pixels, CV_16U, 257);
    ImageMessage message = image_message(pixels, encoding);
    const Image image = require_ok(decode(message));
    CHECK(largest_difference(image, grey_of(bgr)) == 0);
    CHECK(image.rgb[0] == bgr.at<cv::Vec3b>(0, 0)[2]);
    CHECK(image.rgb[2] == bgr.at<cv::Vec3b>(0, 0)[0]);
  }
}

TEST_CASE("NV24 has colour of full size behind its luma") {
  constexpr int width = 7, height = 5;  // odd, which its planes allow
  const cv::Mat y(height, width, CV_8UC1, cv::Scalar(81));
  for (const std::size_t step : {7, 12}) {
    ImageMessage message = image_message(y, "nv24", step);
    for (int row = 0; row < height; ++row) {
      for (int i = 0; i < width; ++i) message.data.insert(message.data.end(), {90, 240});  // red
      message.data.insert(message.data.end(), 2 * (step - width), 0xEE);
    }
    const Image image = require_ok(decode(message));
    CHECK(largest_difference(image, y) == 0);
    for (std::size_t i = 0; i < image.pixels.size(); ++i) {
      REQUIRE(std::abs(image.rgb[3 * i] - 255) < 4);
      REQUIRE(image.rgb[3 * i + 1] < 4);
      REQUIRE(image.rgb[3 * i + 2] < 4);
    }
    message.data.pop_back();
    CHECK(word(decode(message).error().code) == "malformed:image_data");
  }
}

TEST_CASE("I420, which is also called yuv420, and YV12 have a plane for each of Y, U and V") {
  const cv::Mat bgr(14, 22, CV_8UC3, cv::Scalar(20, 60, 220));
  cv::Mat i420;
  cv::cvtColor(bgr, i420, cv::COLOR_BGR2YUV_I420);
  const cv::Mat y = i420.rowRange(0, 14);
  const std::uint8_t blue = i420.ptr()[14 * 22], red = i420.ptr()[14 * 22 + 77];
  for (const std::string encoding : {"i420", "yuv420", "yv12"})
    for (const std::size_t step : {22, 32}) {
      INFO(encoding << ", rows of " << step);
      ImageMessage message = image_message(y, encoding, step);
      for (const bool first : {true, false})
        for (int row = 0; row < 7; ++row) {
          message.data.insert(message.data.end(), 11, first == (encoding != "yv12") ? blue : red);
          message.data.insert(message.data.end(), step / 2 - 11, 0xEE);
        }
      const Image image = require_ok(decode(message));
      CHECK(largest_difference(image, y) == 0);
      for (const std::size_t i : {std::size_t{0}, image.pixels.size() - 1}) {
        CHECK(std::abs(image.rgb[3 * i] - 220) < 4);
        CHECK(std::abs(image.rgb[3 * i + 2] - 20) < 4);
      }
    }
}

TEST_CASE("a Bayer mosaic that image_transport has compressed as it is, is no grey image") {
  const cv::Mat flat(24, 32, CV_8UC3, cv::Scalar(30, 120, 210));
  const cv::Mat raw = mosaic(flat);
  for (const auto& [extension, format] : std::vector<std::pair<std::string, std::string>>{
           {".png", "bayer_bggr8; png compressed "}, {".jpg", "bayer_bggr8; jpeg compressed bayer_bggr8"}}) {
    INFO(format);
    CompressedImageMessage message = compressed(extension, raw, format);
    const Image image = require_ok(decode(message));
    CHECK(largest_difference(image, grey_of(flat)) <= (extension == ".png" ? 1 : 25));
    if (extension == ".png")
      CHECK(std::vector(image.rgb.begin(), image.rgb.begin() + 3) == std::vector<std::uint8_t>{210, 120, 30});
  }
  for (const std::string format : {"bayer_bggr8; jpeg compressed mono8", "mono8; png compressed ", "png", ""}) {
    INFO(format);
    CompressedImageMessage message = compressed(".png", raw, format);
    CHECK(largest_difference(require_ok(decode(message)), raw) == 0);
  }
  CompressedImageMessage converted = compressed(".png", flat, "bayer_bggr8; png compressed bgr8");
  CHECK(largest_difference(require_ok(decode(converted)), grey_of(flat)) == 0);
}

TEST_CASE("a PNG of 16 bits is scaled by the key as a raw image is, and remarked without it") {
  cv::Mat deep(2, 2, CV_16UC1);
  deep.at<std::uint16_t>(0, 0) = 4095;
  deep.at<std::uint16_t>(0, 1) = 2048;
  deep.at<std::uint16_t>(1, 0) = 8;
  deep.at<std::uint16_t>(1, 1) = 0;
  CompressedImageMessage message = compressed(".png", deep, "mono16; png compressed mono16");
  const Image dark = require_ok(decode(message));
  CHECK(dark.pixels == std::vector<std::uint8_t>{15, 8, 0, 0});
  REQUIRE(dark.notes.remarks.size() == 1);
  CHECK(dark.notes.remarks[0].code == ErrorCode::image_bits);
  const ImageBound twelve = ImageBound().with_significant_bits(12);
  const Image scaled = require_ok(decode_compressed_image(message.raw(), Colour::none, twelve));
  CHECK(scaled.pixels == std::vector<std::uint8_t>{255, 128, 0, 0});
  CHECK(scaled.notes.remarks.empty());

  const cv::Mat bgr = colour_scene(22, 14);
  bgr.convertTo(deep, CV_16U, 16);  // 12 bits
  CompressedImageMessage coloured = compressed(".png", deep, "bgr16; png compressed bgr16");
  for (const Colour colour : {Colour::none, Colour::rgb}) {
    const Image image = require_ok(decode_compressed_image(coloured.raw(), colour, twelve));
    CHECK(largest_difference(image, grey_of(bgr)) <= 1);
    CHECK(image.rgb.empty() == (colour == Colour::none));
  }
}

TEST_CASE("what is neither JPEG nor PNG is named by what it is, with the format of the message") {
  for (const auto& [bytes, format, name] : std::vector<std::tuple<std::string, std::string, std::string>>{
           {std::string("RIFF\x10\0\0\0WEBPVP8 ", 16), "webp", "WebP"},
           {std::string("\0\0\0\x01\x67\x42", 6), "h264", "a video stream (H.264 or H.265)"},
           {std::string("\0\0\0\x1c"
                        "ftypavif",
                        12),
            "avif", "AVIF"},
           {std::string("II*\0\x08\0\0\0", 8), "tiff", "TIFF"}}) {
    CompressedImageMessage message;
    message.format = format;
    message.data.assign(bytes.begin(), bytes.end());
    const auto refused = decode(message);
    REQUIRE_FALSE(refused);
    CHECK(word(refused.error().code) == "malformed:compressed_format");
    CHECK(refused.error().context ==
          "data begins neither as a JPEG nor as a PNG, but as " + name + "; its format is '" + format + "'");
  }
}

TEST_CASE("a compressed depth image is told as one, by its format and by what precedes its PNG") {
  const cv::Mat depth(4, 6, CV_16UC1, cv::Scalar(1234));
  CompressedImageMessage message = compressed(".png", depth, "png");
  message.data.insert(message.data.begin(), 12, 0);
  CHECK(word(decode(message).error().code) == "malformed:depth_encoding");
  CHECK_THAT(decode(message).error().context, Catch::Matchers::StartsWith("a PNG follows 12 bytes of parameters"));
  message.format = "mono16; compressedDepth png";
  CHECK(word(decode(message).error().code) == "malformed:depth_encoding");
}

TEST_CASE("a frame of motion JPEG without Huffman tables is read with those of the standard") {
  const cv::Mat grey = grey_of(colour_scene(64, 48));
  CompressedImageMessage whole = compressed(".jpg", grey, "jpeg"), bare = whole;
  for (std::size_t at = 2; bare.data[at + 1] != 0xDA;) {
    const std::size_t length = 2 + (bare.data[at + 2] << 8 | bare.data[at + 3]);
    if (bare.data[at + 1] == 0xC4)
      bare.data.erase(bare.data.begin() + static_cast<std::ptrdiff_t>(at),
                      bare.data.begin() + static_cast<std::ptrdiff_t>(at + length));
    else
      at += length;
  }
  REQUIRE(bare.data.size() < whole.data.size());
  CHECK(require_ok(decode(bare)).pixels == require_ok(decode(whole)).pixels);
}

TEST_CASE("a buffer whose width and height were rounded up is read by its own rows") {
  const cv::Mat bgr = colour_scene(41, 30);
  ImageMessage message = image_message(bgr, "bgr8", 48 * 3);  // to 48 x 32, as a camera's hardware wants it
  message.data.insert(message.data.end(), 2 * 48 * 3, 0xEE);
  message.step = 41 * 3;
  const Image image = require_ok(decode(message));
  CHECK(largest_difference(image, grey_of(bgr)) == 0);
  REQUIRE(image.notes.remarks.size() == 1);
  CHECK(word(image.notes.remarks[0].code) == "malformed:step");
  CHECK_THAT(image.notes.remarks[0].context,
             Catch::Matchers::EndsWith("rows of 144 bytes, of which it is as long as 32"));
  ImageMessage trailing = image_message(bgr, "bgr8");  // some bytes of another kind behind the pixels
  trailing.data.insert(trailing.data.end(), 64, 0xEE);
  const Image plain = require_ok(decode(trailing));
  CHECK(largest_difference(plain, grey_of(bgr)) == 0);
  CHECK(plain.notes.remarks.empty());
}

TEST_CASE("data that is as long as another number of bytes a pixel is told so") {
  ImageMessage message = image_message(cv::Mat(4, 6, CV_8UC1, cv::Scalar(7)), "yuv422_yuy2");
  message.step = 12;
  const auto refused = decode(message);
  CHECK(word(refused.error().code) == "malformed:image_data");
  CHECK_THAT(refused.error().context,
             Catch::Matchers::EndsWith("; that is 1 a pixel, where yuv422_yuy2 has 2: is the encoding right?"));
}

TEST_CASE("YUYV under the name of UYVY is remarked, and sound images are not") {
  cv::Mat yuyv(48, 64, CV_8UC2);
  cv::RNG random(3);
  for (int row = 0; row < yuyv.rows; ++row)
    for (int column = 0; column < yuyv.cols; ++column)
      yuyv.at<cv::Vec2b>(row, column) = {cv::saturate_cast<std::uint8_t>(4 * column + random.uniform(-5, 5)),
                                         cv::saturate_cast<std::uint8_t>(128 + random.uniform(-8, 8))};
  ImageMessage right = image_message(yuyv, "yuv422_yuy2"), wrong = image_message(yuyv, "yuv422");
  CHECK(require_ok(decode(right)).notes.remarks.empty());
  const Image image = require_ok(decode(wrong));
  REQUIRE(image.notes.remarks.size() == 1);
  CHECK(word(image.notes.remarks[0].code) == "malformed:encoding");
  CHECK_THAT(image.notes.remarks[0].context,
             Catch::Matchers::EndsWith("may publish yuyv (yuv422_yuy2) under that name"));
}
