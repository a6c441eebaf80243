#include <algorithm>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "dds/decode.hpp"
#include "support/catch.hpp"
#include "support/ros_messages.hpp"
#include "support/support.hpp"

using namespace calib;
using namespace calib::test;

namespace {

Result<Image> decode(ImageMessage& message) { return decode_image(message.raw()); }
Result<Image> decode(CompressedImageMessage& message) { return decode_compressed_image(message.raw()); }

/// A scene with edges and noise, so that a swapped channel or pattern cannot pass.
cv::Mat colour_scene(int width, int height) {
  cv::Mat scene(height, width, CV_8UC3);
  cv::RNG random(7);
  random.fill(scene, cv::RNG::UNIFORM, 0, 256);
  cv::rectangle(scene, {width / 4, height / 4, width / 2, height / 2}, {20, 90, 230}, cv::FILLED);
  return scene;
}

ImageMessage image_message(const cv::Mat& pixels, const std::string& encoding, std::uint32_t padding = 0) {
  ImageMessage message;
  message.width = static_cast<std::uint32_t>(pixels.cols);
  message.height = static_cast<std::uint32_t>(pixels.rows);
  message.step = static_cast<std::uint32_t>(pixels.cols * pixels.elemSize()) + padding;
  message.encoding = encoding;
  message.data.assign(std::size_t{message.step} * message.height, 0xEE);
  for (int row = 0; row < pixels.rows; ++row)
    std::copy_n(pixels.ptr(row), pixels.cols * pixels.elemSize(), message.data.data() + row * message.step);
  return message;
}

CompressedImageMessage compressed_message(const std::string& extension, const cv::Mat& pixels) {
  CompressedImageMessage message;
  REQUIRE(cv::imencode(extension, pixels, message.data));
  return message;
}

int largest_difference(const Image& image, const cv::Mat& expected) {
  REQUIRE(image.width == expected.cols);
  REQUIRE(image.height == expected.rows);
  const cv::Mat got(image.height, image.width, CV_8UC1, const_cast<std::uint8_t*>(image.pixels.data()));
  return static_cast<int>(cv::norm(got, expected, cv::NORM_INF));
}

/// The Bayer mosaic that a sensor with `pattern` (first row, then second row) sees of a BGR scene.
cv::Mat mosaic(const cv::Mat& scene, const std::string& pattern) {
  cv::Mat raw(scene.rows, scene.cols, CV_8UC1);
  for (int y = 0; y < scene.rows; ++y)
    for (int x = 0; x < scene.cols; ++x) {
      const char colour = pattern[2 * (y % 2) + x % 2];
      raw.at<std::uint8_t>(y, x) = scene.at<cv::Vec3b>(y, x)[colour == 'b' ? 0 : colour == 'g' ? 1 : 2];
    }
  return raw;
}

}  // namespace

TEST_CASE("every encoding gives OpenCV's grey, with and without padded rows") {
  const cv::Mat bgr = colour_scene(22, 14);
  cv::Mat grey, rgb, bgra, rgba;
  cv::cvtColor(bgr, grey, cv::COLOR_BGR2GRAY);
  cv::cvtColor(bgr, rgb, cv::COLOR_BGR2RGB);
  cv::cvtColor(bgr, bgra, cv::COLOR_BGR2BGRA);
  cv::cvtColor(bgr, rgba, cv::COLOR_BGR2RGBA);
  const std::vector<std::pair<std::string, cv::Mat>> encoded{
      {"mono8", grey}, {"8UC1", grey}, {"bgr8", bgr}, {"8UC3", bgr}, {"rgb8", rgb}, {"bgra8", bgra}, {"rgba8", rgba}};
  for (const auto& [encoding, pixels] : encoded)
    for (const std::uint32_t padding : {0U, 1U, 13U}) {
      INFO(encoding << " with rows padded by " << padding);
      ImageMessage message = image_message(pixels, encoding, padding);
      CHECK(largest_difference(require_ok(decode(message)), grey) == 0);
    }
}

TEST_CASE("16-bit grey is scaled from its full range, in both byte orders and at odd addresses") {
  cv::Mat deep(9, 11, CV_16UC1), expected;
  cv::RNG random(3);
  random.fill(deep, cv::RNG::UNIFORM, 0, 65536);
  deep.at<std::uint16_t>(0, 0) = 65535;
  deep.at<std::uint16_t>(0, 1) = 0;
  deep.convertTo(expected, CV_8U, 255.0 / 65535.0);
  for (const std::uint32_t padding : {0U, 1U}) {
    ImageMessage message = image_message(deep, "mono16", padding);
    CHECK(largest_difference(require_ok(decode(message)), expected) == 0);
    for (std::size_t row = 0; row < message.height; ++row)
      for (std::size_t i = 0; i + 1 < 22; i += 2)
        std::swap(message.data[row * message.step + i], message.data[row * message.step + i + 1]);
    message.is_bigendian = 1;
    CHECK(largest_difference(require_ok(decode(message)), expected) == 0);
  }
}

TEST_CASE("a Bayer image of a smooth scene gives the grey of that scene for every pattern") {
  // Strong colours: a pattern mistaken for another swaps red and blue, 60 grey levels apart here.
  cv::Mat bgr(24, 32, CV_8UC3, cv::Scalar(10, 120, 250)), grey;
  cv::cvtColor(bgr, grey, cv::COLOR_BGR2GRAY);
  for (const std::string pattern : {"rggb", "bggr", "gbrg", "grbg"}) {
    INFO(pattern);
    ImageMessage message = image_message(mosaic(bgr, pattern), "bayer_" + pattern + "8");
    CHECK(largest_difference(require_ok(decode(message)), grey) <= 1);
  }
}

TEST_CASE("YUV 4:2:2 gives its luma, in either byte order") {
  const cv::Mat scene = colour_scene(22, 14);
  cv::Mat luma;
  cv::cvtColor(scene, luma, cv::COLOR_BGR2GRAY);
  for (const std::string encoding : {"yuv422", "uyvy", "yuv422_yuy2", "yuyv"}) {
    INFO(encoding);
    cv::Mat packed(luma.rows, luma.cols, CV_8UC2, cv::Scalar(200, 200));
    cv::insertChannel(luma, packed, encoding == "yuv422" || encoding == "uyvy" ? 1 : 0);
    ImageMessage message = image_message(packed, encoding, 4);
    CHECK(largest_difference(require_ok(decode(message)), luma) == 0);
  }
}

TEST_CASE("a compressed image decodes to the pixels of the camera") {
  const cv::Mat scene = colour_scene(64, 48);
  cv::Mat grey;
  cv::cvtColor(scene, grey, cv::COLOR_BGR2GRAY);
  auto png = compressed_message(".png", grey);
  const Image image = require_ok(decode(png));
  CHECK(image.stamp == std::chrono::seconds(12) + std::chrono::nanoseconds(345));
  CHECK(largest_difference(image, grey) == 0);
  auto jpeg = compressed_message(".jpg", cv::Mat(48, 64, CV_8UC1, cv::Scalar(77)));
  CHECK(largest_difference(require_ok(decode(jpeg)), cv::Mat(48, 64, CV_8UC1, cv::Scalar(77))) <= 1);
}

TEST_CASE("an EXIF orientation does not turn the image") {
  auto message = compressed_message(".jpg", colour_scene(64, 48));
  const Octets exif{
      0xFF, 0xE1, 0x00, 0x22, 'E', 'x', 'i', 'f', 0, 0, 'M', 'M', 0, 42, 0, 0, 0, 8,   // one IFD entry:
      0,    1,    0x01, 0x12, 0,   3,   0,   0,   0, 1, 0,   6,   0, 0,  0, 0, 0, 0};  // turn by 90 degrees
  message.data.insert(message.data.begin() + 2, exif.begin(), exif.end());
  cv::Mat turned = cv::imdecode(message.data, cv::IMREAD_GRAYSCALE);
  REQUIRE(turned.cols == 48);  // the tag is understood by those who look at it
  CHECK(require_ok(decode(message)).width == 64);
}

TEST_CASE("a JPEG's size is read from its frame header, before any decoding") {
  auto message = compressed_message(".jpg", colour_scene(64, 48));
  CHECK(require_ok(decode(message)).width == 64);
  std::size_t frame = 2;
  while (message.data[frame + 1] != 0xC0) frame += 2 + (message.data[frame + 2] << 8 | message.data[frame + 3]);
  std::fill_n(message.data.begin() + frame + 5, 4, std::uint8_t{0xFF});  // 65535 x 65535
  CHECK(decode(message).error().code == "malformed:compressed_dimensions");
  std::fill_n(message.data.begin() + frame + 5, 4, std::uint8_t{0});
  CHECK(decode(message).error().code == "malformed:compressed_dimensions");
  message.data.resize(frame);  // no frame header at all
  CHECK(decode(message).error().code == "malformed:compressed_dimensions");
}

TEST_CASE("an incomplete JPEG is refused, a padded one is not") {
  auto message = compressed_message(".jpg", colour_scene(64, 48));
  message.data.insert(message.data.end(), 100, 0);
  CHECK(decode(message));
  message.data.resize(message.data.size() / 2);
  CHECK(decode(message).error().code == "malformed:compressed_data");
}

TEST_CASE("colour is decoded on request and does not change the grey") {
  const cv::Mat scene = colour_scene(32, 24);
  cv::Mat rgb, rgba, bgra;
  cv::cvtColor(scene, rgb, cv::COLOR_BGR2RGB);
  cv::cvtColor(scene, rgba, cv::COLOR_BGR2RGBA);
  cv::cvtColor(scene, bgra, cv::COLOR_BGR2BGRA);
  const auto largest_colour_difference = [&](const Image& image) {
    REQUIRE(image.rgb.size() == 3 * image.pixels.size());
    const cv::Mat got(image.height, image.width, CV_8UC3, const_cast<std::uint8_t*>(image.rgb.data()));
    return static_cast<int>(cv::norm(got, rgb, cv::NORM_INF));
  };
  for (auto& [pixels, encoding] : std::vector<std::pair<cv::Mat, std::string>>{
           {scene, "bgr8"}, {scene, "8UC3"}, {rgb, "rgb8"}, {rgba, "rgba8"}, {bgra, "bgra8"}}) {
    INFO(encoding);
    ImageMessage message = image_message(pixels, encoding, 5);
    const Image coloured = require_ok(decode_image(message.raw(), Colour::rgb));
    CHECK(largest_colour_difference(coloured) == 0);
    const Image grey = require_ok(decode(message));
    CHECK(coloured.pixels == grey.pixels);
    CHECK(grey.rgb.empty());
  }
  CompressedImageMessage png = compressed_message(".png", scene);
  const Image coloured = require_ok(decode_compressed_image(png.raw(), Colour::rgb));
  CHECK(largest_colour_difference(coloured) == 0);
  CHECK(coloured.pixels.size() == std::size_t{32 * 24});

  // A mosaic of one colour has that colour everywhere, whatever the pattern.
  const cv::Mat flat(24, 32, CV_8UC3, cv::Scalar(30, 120, 210));
  for (const std::string pattern : {"rggb", "bggr", "gbrg", "grbg"}) {
    ImageMessage message = image_message(mosaic(flat, pattern), "bayer_" + pattern + "8");
    const Image image = require_ok(decode_image(message.raw(), Colour::rgb));
    for (std::size_t i = 0; i < image.pixels.size(); ++i) {
      REQUIRE(image.rgb[3 * i] == 210);
      REQUIRE(image.rgb[3 * i + 1] == 120);
      REQUIRE(image.rgb[3 * i + 2] == 30);
    }
  }
  const cv::Mat luma_chroma(24, 32, CV_8UC2, cv::Scalar(128, 77));  // without colour
  ImageMessage message = image_message(luma_chroma, "uyvy");
  const Image image = require_ok(decode_image(message.raw(), Colour::rgb));
  CHECK((image.rgb[0] == image.rgb[1] && image.rgb[1] == image.rgb[2]));

  ImageMessage mono = image_message(cv::Mat(24, 32, CV_8UC1, cv::Scalar(9)), "mono8");
  CHECK(require_ok(decode_image(mono.raw(), Colour::rgb)).rgb.empty());
}

TEST_CASE("16-bit colour and Bayer images give what those of 8 bits give, in both byte orders") {
  const cv::Mat bgr = colour_scene(22, 14);
  cv::Mat rgb;
  cv::cvtColor(bgr, rgb, cv::COLOR_BGR2RGB);
  const std::vector<std::pair<std::string, cv::Mat>> encoded{{"rgb", rgb},
                                                             {"bgr", bgr},
                                                             {"bayer_rggb", mosaic(bgr, "rggb")},
                                                             {"bayer_bggr", mosaic(bgr, "bggr")},
                                                             {"bayer_gbrg", mosaic(bgr, "gbrg")},
                                                             {"bayer_grbg", mosaic(bgr, "grbg")}};
  for (const auto& [encoding, pixels] : encoded) {
    INFO(encoding);
    ImageMessage eight = image_message(pixels, encoding + "8");
    const Image expected = require_ok(decode_image(eight.raw(), Colour::rgb));
    cv::Mat deep;
    pixels.convertTo(deep, CV_16U, 257);
    ImageMessage message = image_message(deep, encoding + "16", 3);
    const Image image = require_ok(decode_image(message.raw(), Colour::rgb));
    CHECK(image.pixels == expected.pixels);
    CHECK(image.rgb == expected.rgb);
    for (std::size_t row = 0; row < message.height; ++row)
      for (std::size_t i = row * message.step; i + 4 < (row + 1) * message.step; i += 2)
        std::swap(message.data[i], message.data[i + 1]);
    message.is_bigendian = 1;
    CHECK(require_ok(decode_image(message.raw(), Colour::rgb)).pixels == expected.pixels);
  }
}

TEST_CASE("values of fewer bits than 16 are scaled by the key, and remarked without it") {
  cv::Mat deep(2, 2, CV_16UC1);
  deep.at<std::uint16_t>(0, 0) = 4095;
  deep.at<std::uint16_t>(0, 1) = 2048;
  deep.at<std::uint16_t>(1, 0) = 8;
  deep.at<std::uint16_t>(1, 1) = 0;
  ImageMessage message = image_message(deep, "mono16");
  const Image dark = require_ok(decode(message));
  CHECK(dark.pixels == std::vector<std::uint8_t>{16, 8, 0, 0});
  REQUIRE(dark.notes.remarks.size() == 1);
  CHECK(dark.notes.remarks[0].code == ErrorCode::image_bits);
  CHECK(
      dark.notes.remarks[0].context ==
      "its values of 16 bits stay below 4096 (the greatest is 4095); if the camera has 12 bits, write camera.bits: 12");
  const Image scaled = require_ok(decode_image(message.raw(), Colour::none, ImageBound().with_significant_bits(12)));
  CHECK(scaled.pixels == std::vector<std::uint8_t>{255, 128, 0, 0});
  CHECK(scaled.notes.remarks.empty());
  deep.at<std::uint16_t>(0, 0) = 65535;
  message = image_message(deep, "mono16");
  CHECK(require_ok(decode(message)).notes.remarks.empty());
  CHECK(require_ok(decode_image(message.raw(), Colour::none, ImageBound().with_significant_bits(12))).pixels[0] == 255);
}

TEST_CASE("NV12 and NV21 give their luma, and the colours of their planes") {
  const cv::Mat bgr(14, 22, CV_8UC3, cv::Scalar(20, 60, 220));
  cv::Mat planar;
  cv::cvtColor(bgr, planar, cv::COLOR_BGR2YUV_I420);
  const cv::Mat y = planar.rowRange(0, 14);
  const std::uint8_t blue = planar.ptr()[14 * 22], red = planar.ptr()[14 * 22 + 77];
  for (const std::string encoding : {"nv12", "nv21"})
    for (const std::uint32_t padding : {0U, 10U}) {
      INFO(encoding << ", rows padded by " << padding);
      ImageMessage message = image_message(y, encoding, padding);
      for (int row = 0; row < 7; ++row) {
        for (int i = 0; i < 11; ++i)
          for (const std::uint8_t value : {encoding == "nv12" ? blue : red, encoding == "nv12" ? red : blue})
            message.data.push_back(value);
        message.data.insert(message.data.end(), padding, 0xEE);
      }
      const Image image = require_ok(decode_image(message.raw(), Colour::rgb));
      CHECK(largest_difference(image, y) == 0);
      REQUIRE(image.rgb.size() == 3 * image.pixels.size());
      CHECK(std::abs(image.rgb[0] - 220) < 4);
      CHECK(std::abs(image.rgb[2] - 20) < 4);
      message.data.pop_back();
      CHECK(word(decode(message).error().code) == "malformed:image_data");
    }
  ImageMessage odd = image_message(cv::Mat(3, 6, CV_8UC1), "nv12");
  odd.data.resize(30);
  CHECK(word(decode(odd).error().code) == "malformed:image_size");
}

TEST_CASE("the step of an image is ignored where its data is without padding") {
  ImageMessage message;
  for (const std::uint32_t step : {0U, 5U, 9000U, 0xFFFFFFFFU}) {
    message.step = step;
    const Image image = require_ok(decode(message));
    CHECK(image.pixels == std::vector<std::uint8_t>(24, 7));
    REQUIRE(image.notes.remarks.size() == 1);
    CHECK(image.notes.remarks[0].context.starts_with("step is " + std::to_string(step) + ", and a row has 6 bytes"));
  }
}

TEST_CASE("an encoding that is not converted is named beside those that are") {
  ImageMessage message;
  message.encoding = "\x1b[2Jyuv9";
  const auto refused = decode(message);
  CHECK_THAT(refused.error().context, Catch::Matchers::StartsWith("encoding '\\x1b[2Jyuv9' is none of mono8, 8UC1, "));
  CHECK_THAT(refused.error().context, Catch::Matchers::ContainsSubstring("nv12, nv21"));
}
