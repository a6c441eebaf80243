#include "calib/image_header.hpp"

#include <algorithm>
#include <opencv2/imgcodecs.hpp>
#include <string>
#include <vector>

#include "support/catch.hpp"

using namespace calib;

namespace {

std::string encoded(const std::string& extension, int type, const std::vector<int>& parameters = {}) {
  cv::Mat pixels(31, 43, type, cv::Scalar::all(7));
  cv::randu(pixels, 0, 255);
  std::vector<std::uint8_t> bytes;
  REQUIRE(cv::imencode(extension, pixels, bytes, parameters));
  return {bytes.begin(), bytes.end()};
}

std::string big_endian(std::uint32_t value, int size) {
  std::string bytes;
  while (size-- > 0) bytes += static_cast<char>(value >> 8 * size);
  return bytes;
}

std::string segment(char marker, const std::string& content) {
  return std::string("\xff") + marker + big_endian(static_cast<std::uint32_t>(content.size() + 2), 2) + content;
}

const std::string start_of_image = "\xff\xd8", start_of_scan = segment('\xda', "selection");
/// Of 300 x 200 pixels.
const std::string start_of_frame = segment('\xc2', "\x08" + big_endian(200, 2) + big_endian(300, 2) + "components");

std::string png_of(std::uint32_t width, std::uint32_t height) {
  return "\x89PNG\r\n\x1a\n" + big_endian(13, 4) + "IHDR" + big_endian(width, 4) + big_endian(height, 4);
}

}  // namespace

TEST_CASE("the size of an image is known before it is decoded") {
  const std::pair<std::string, int> kinds[] = {{".png", CV_8UC1}, {".png", CV_16UC1}, {".png", CV_8UC3},
                                               {".jpg", CV_8UC3}, {".jpg", CV_8UC1},  {".tiff", CV_32FC1},
                                               {".tif", CV_8UC3}, {".bmp", CV_8UC1},  {".bmp", CV_8UC3},
                                               {".pgm", CV_8UC1}, {".ppm", CV_8UC3},  {".pfm", CV_32FC1}};
  for (const auto& [extension, type] : kinds) {
    INFO(extension << ' ' << type);
    const std::string bytes = encoded(extension, type);
    const auto header = read_image_header(bytes);
    REQUIRE(header);
    CHECK(header->width == 43);
    CHECK(header->height == 31);
    CHECK(header->scans == 1);
    CHECK(header->in_bounds());
    for (std::size_t length = 0; length < std::min<std::size_t>(bytes.size(), 512); ++length)
      if (const auto of_part = read_image_header(bytes.substr(0, length))) CHECK(of_part->width >= 0);
  }
  const auto header = read_image_header("P5\n# a comment\n 43 # and one more\n31\n255\n");
  REQUIRE(header);
  CHECK(header->height == 31);
}

TEST_CASE("what no reader is asked to decode has no header") {
  for (const std::string& bytes :
       {std::string(), std::string("text"), std::string("GIF89a\1\0\1\0"), std::string("P7\nWIDTH 3\n"),
        std::string("P5 wide high"), std::string("II*\0\xff\xff\xff\xff", 8), std::string("BM"),
        std::string("\xff\xd8\xff"), start_of_image + segment('\xe0', "JFIF") + start_of_scan + "\xff\xd9"})
    CHECK_FALSE(read_image_header(bytes));
}

TEST_CASE("an image that would take too much memory is out of bounds") {
  CHECK(read_image_header(png_of(8000, 8000))->in_bounds());
  CHECK_FALSE(read_image_header(png_of(8000, 8001))->in_bounds());
  CHECK_FALSE(read_image_header(png_of(0, 100))->in_bounds());
  CHECK_FALSE(read_image_header(png_of(0xffffffff, 0xffffffff))->in_bounds());
  CHECK_FALSE(read_image_header("P5 -3 4 255\n")->in_bounds());
}

TEST_CASE("the scans of a JPEG are counted, wherever they are hidden, and a thumbnail is not taken for the image") {
  const auto scans = [](const std::string& bytes) {
    const auto header = read_image_header(bytes);
    return header && header->width == 300 && header->height == 200 ? header->scans : -1;
  };
  const std::string data("entropy\xff\0coded\xff\xd0more", 19);
  const std::string thumbnail = segment('\xe1', start_of_image + segment('\xc0', std::string(9, '\1')) + start_of_scan);
  const std::string head = start_of_image + thumbnail + start_of_frame;
  CHECK(scans(head + start_of_scan + data + "\xff\xd9") == 1);
  CHECK(scans(head + start_of_scan + data + start_of_scan + data + "\xff\xd9") == 2);
  // libjpeg goes on behind fill bytes, and behind what does not belong there.
  CHECK(scans(head + "\xff\xff\xff" + start_of_scan + data + segment('\xc4', "table") + "garbage" + start_of_scan) ==
        2);
  CHECK(scans(head + start_of_scan + data + "\xff\xd9" + start_of_scan) == 1);
  // What follows the end of the image does not matter, and without that end it is cut short.
  for (const std::string tail : {"", "\xff\xff\xff\xff", "a second picture"})
    CHECK(read_image_header(head + start_of_scan + data + "\xff\xff\xff\xd9" + tail)->complete);
  CHECK_FALSE(read_image_header(head + start_of_scan + data)->complete);
  CHECK_FALSE(read_image_header(head + "\xff\xd9")->complete);
  std::string many = head;
  for (int i = 0; i < 100; ++i) many += start_of_scan + data;
  CHECK(read_image_header(many)->in_bounds());
  CHECK_FALSE(read_image_header(many + start_of_scan)->in_bounds());
  CHECK(read_image_header(encoded(".jpg", CV_8UC3, {cv::IMWRITE_JPEG_PROGRESSIVE, 1}))->scans > 3);
}
