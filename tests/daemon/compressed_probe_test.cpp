#include "dds/compressed_probe.hpp"

#include <sys/mman.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <opencv2/imgcodecs.hpp>

#include "dds/decode.hpp"
#include "support/catch.hpp"
#include "support/compressed_files.hpp"
#include "support/support.hpp"

using namespace calib;
using namespace calib::test;

namespace {

/// What `check_compressed` says: nothing when it is good.
std::string refusal(const Octets& bytes) {
  const auto header = probe_compressed(bytes);
  if (!header) return word(header.error().code);
  const auto checked = check_compressed(bytes, *header);
  return checked ? "" : word(checked.error().code);
}

cv::Mat scene(int width, int height, int type = CV_8UC3) {
  cv::Mat scene(height, width, type);
  cv::randu(scene, 0, 256);
  return scene;
}

Octets encoded(const std::string& extension, const cv::Mat& pixels, const std::vector<int>& how = {}) {
  Octets bytes;
  REQUIRE(cv::imencode(extension, pixels, bytes, how));
  return bytes;
}

Result<Image> decode(Octets bytes, const ImageBound& bound = {}, Colour colour = Colour::none) {
  CompressedImageMessage message;
  message.data = std::move(bytes);
  return decode_compressed_image(message.raw(), colour, bound);
}

}  // namespace

TEST_CASE("images of usual cameras and encoders are accepted") {
  for (const int type : {CV_8UC1, CV_8UC3}) {
    CHECK(refusal(encoded(".jpg", scene(65, 33, type))).empty());
    CHECK(refusal(encoded(".jpg", scene(65, 33, type), {cv::IMWRITE_JPEG_PROGRESSIVE, 1})).empty());
    CHECK(refusal(encoded(".jpg", scene(65, 33, type), {cv::IMWRITE_JPEG_RST_INTERVAL, 1})).empty());
    CHECK(refusal(encoded(".png", scene(65, 33, type))).empty());
  }
  CHECK(refusal(encoded(".png", scene(65, 33, CV_16UC1))).empty());
  CHECK(refusal(encoded(".png", scene(65, 33, CV_8UC4))).empty());
  CHECK(refusal(encoded(".png", scene(65, 33, CV_8UC1), {cv::IMWRITE_PNG_BILEVEL, 1})).empty());
}

TEST_CASE("a JPEG may have 32 scans; the error for more gives their number") {
  CHECK(refusal(jpeg_of_scans(64, 48, 32)).empty());
  CHECK(require_ok(decode(jpeg_of_scans(64, 48, 32))).width == 64);
  const Octets one_more = jpeg_of_scans(64, 48, 33);
  CHECK(refusal(one_more) == "malformed:compressed_scans");
  const auto refused = check_compressed(one_more, require_ok(probe_compressed(one_more)));
  CHECK(refused.error().context == "the JPEG has 33 scans where 32 are allowed");
}

TEST_CASE("variants of JPEG that cameras do not send are refused") {
  CHECK(refusal(jpeg_of_scans(64, 48, 1, 0xC0)).empty());
  for (const int frame : {0xC3, 0xC5, 0xC6, 0xC7, 0xC9, 0xCA, 0xCB, 0xCD, 0xCE, 0xCF})
    CHECK(refusal(jpeg_of_scans(64, 48, 1, frame)) == "malformed:compressed_format");
  Octets two_frames = jpeg_of_scans(64, 48, 1);
  const Octets frame(two_frames.begin() + 71, two_frames.begin() + 84);
  REQUIRE(frame[1] == 0xC2);
  two_frames.insert(two_frames.begin() + 84, frame.begin(), frame.end());
  CHECK(refusal(two_frames) == "malformed:compressed_format");
  Octets deep = jpeg_of_scans(64, 48, 1);
  deep[75] = 12;
  CHECK(refusal(deep) == "malformed:compressed_format");
}

TEST_CASE("a JPEG that is incomplete is refused; what follows its end does not matter") {
  const Octets good = encoded(".jpg", scene(40, 30));
  for (std::size_t size = 0; size < good.size(); size += 7)
    CHECK_FALSE(refusal({good.begin(), good.begin() + size}).empty());
  for (const int filling : {0x00, 0xFF, 0xD8}) {
    Octets padded = good;
    padded.insert(padded.end(), 1000, static_cast<std::uint8_t>(filling));
    INFO(filling);
    CHECK(refusal(padded).empty());
    CHECK(require_ok(decode(padded)).pixels == require_ok(decode(good)).pixels);
  }
  Octets longer = good;  // a second picture
  longer.insert(longer.end(), good.begin(), good.end());
  CHECK(require_ok(decode(longer)).pixels == require_ok(decode(good)).pixels);
}

TEST_CASE("a PNG with fewer pixels than its header says is refused, and one with many more is too") {
  CHECK(require_ok(decode(black_png(64, 48, 48))).pixels == std::vector<std::uint8_t>(64 * 48, 0));
  CHECK(decode(black_png(64, 48, 47)).error().code == "malformed:compressed_data");
  CHECK(decode(black_png(64, 48, 49)));
  // 71 MB of zeros in 69 kB: as many as fit in what an image of this size may have are decompressed by nobody.
  CHECK(decode(black_png(64, 48, 1'090'000)).error().code == "malformed:compressed_data");
  Octets odd = black_png(64, 48, 48);
  odd[24] = 3;  // bits
  CHECK(decode(odd).error().code == "malformed:compressed_data");
}

TEST_CASE("an interlaced PNG is decoded") {
  // 5 x 5 of 8 bits: passes of 1x1, 1x1, 2x1, 1x2, 3x1, 2x3, 5x2 pixels and a byte for each row of each.
  const std::size_t raw = (1 + 1) + (1 + 1) + (2 + 1) + 2 * (1 + 1) + (3 + 1) + 3 * (2 + 1) + 2 * (5 + 1);
  Octets png{0x89, 'P', 'N', 'G', '\r', '\n', 0x1A, '\n'};
  put_chunk(png, "IHDR", {0, 0, 0, 5, 0, 0, 0, 5, 8, 0, 0, 0, 1});
  put_chunk(png, "IDAT", deflated(raw));
  put_chunk(png, "IEND", {});
  CHECK(require_ok(decode(png)).pixels == std::vector<std::uint8_t>(25, 0));
}

TEST_CASE("metadata of a PNG is bounded, and animation is refused") {
  const auto with = [](const std::string& kind, std::size_t bytes, int times) {
    return refusal(
        black_png(64, 48, 48, std::vector<std::pair<std::string, Octets>>(times, {kind, Octets(bytes, 'x')})));
  };
  CHECK(with("tEXt", 100, 5).empty());
  CHECK(with("tEXt", 1 << 19, 1).empty());
  CHECK(with("tEXt", 1 << 19, 2) == "malformed:compressed_metadata");
  CHECK(with("zTXt", 100, 4).empty());
  for (const std::string kind : {"iCCP", "zTXt", "iTXt"}) CHECK(with(kind, 100, 5) == "malformed:compressed_metadata");
  for (const std::string kind : {"acTL", "fcTL", "fdAT"}) CHECK(with(kind, 8, 1) == "malformed:compressed_format");
}

TEST_CASE("an image of another size than the configured one is refused without decoding") {
  const ImageBound bound = ImageBound::exactly({640, 480}, "camera.size");
  const Octets many_scans = jpeg_of_scans(8000, 8000, 600), many_pixels = black_png(8000, 8000, 8000);
  REQUIRE(many_scans.size() < 57'000);
  REQUIRE(many_pixels.size() < 70'000);
  for (const Octets& bomb : {many_scans, many_pixels}) {
    const auto begin = std::chrono::steady_clock::now();
    for (int i = 0; i < 100; ++i) {
      const auto refused = decode(bomb, bound);
      REQUIRE(refused.error().code == "image_size_mismatch");
      REQUIRE(refused.error().context == "the image is 8000 x 8000, and camera.size is 640 x 480");
    }
    // One of them took seconds and hundreds of megabytes. Copying the bytes is most of what is left.
    CHECK(std::chrono::steady_clock::now() - begin < std::chrono::seconds(1));
  }
}

TEST_CASE("a compressed image has at most four bytes a pixel and 64 KiB") {
  Octets bytes = encoded(".jpg", scene(64, 48));
  bytes.resize(64 * 48 * 4 + 64 * 1024, 0);
  CHECK(decode(bytes));
  bytes.push_back(0);
  CHECK(decode(bytes).error().code == "malformed:compressed_size");
}

TEST_CASE("pixels equal those of OpenCV's decoders, grey and in colour") {
  const cv::Mat coloured = scene(65, 33), grey = scene(65, 33, CV_8UC1);
  cv::Mat deep(33, 65, CV_16UC3), transparent = scene(65, 33, CV_8UC4);
  cv::randu(deep, 0, 65536);
  const std::vector<Octets> files{encoded(".jpg", coloured),
                                  encoded(".jpg", grey),
                                  encoded(".png", coloured),
                                  encoded(".png", grey),
                                  encoded(".png", deep),
                                  encoded(".png", transparent),
                                  encoded(".jpg", coloured, {cv::IMWRITE_JPEG_PROGRESSIVE, 1})};
  for (const Octets& file : files) {
    const cv::Mat expected_grey = cv::imdecode(file, cv::IMREAD_GRAYSCALE), bgr = cv::imdecode(file, cv::IMREAD_COLOR);
    const Image in_grey = require_ok(decode(file)), in_colour = require_ok(decode(file, {}, Colour::rgb));
    CHECK(std::equal(in_grey.pixels.begin(), in_grey.pixels.end(), expected_grey.data));
    REQUIRE(in_colour.rgb.size() == 3 * bgr.total());
    for (std::size_t i = 0; i < in_colour.rgb.size(); ++i) REQUIRE(in_colour.rgb[i] == bgr.data[i / 3 * 3 + 2 - i % 3]);
  }
}

TEST_CASE("messages of the decoders do not reach standard error") {
  const Octets complained_of =
      black_png(64, 48, 48, {{"tEXt", Octets(100, 0)}, {"gAMA", Octets(3, 0)}, {"tIME", Octets(1, 0)}});
  std::fflush(stderr);
  const int before = dup(2), file = memfd_create("stderr", 0);
  dup2(file, 2);
  const bool taken = decode(jpeg_of_scans(64, 48, 5)) && decode(complained_of);
  const bool refused = !decode(black_png(64, 48, 47));
  std::fflush(stderr);
  dup2(before, 2);
  CHECK(taken);
  CHECK(refused);
  CHECK(lseek(file, 0, SEEK_END) == 0);
  close(file);
  close(before);
}
