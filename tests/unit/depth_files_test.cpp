#include "dataset/depth_files.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <fstream>
#include <limits>
#include <opencv2/imgcodecs.hpp>

#include "support/catch.hpp"
#include "support/support.hpp"

using namespace calib;
namespace fs = std::filesystem;

namespace {

constexpr int width = 32, height = 16;

Camera camera() { return Camera::make(CameraModel::rectified, width, height, {20, 20, 15.5, 7.5}).value(); }

/// Values of a map that differ from pixel to pixel, with one zero, one negative and two that are not finite.
std::vector<float> values() {
  std::vector<float> all;
  for (int i = 0; i < width * height; ++i) all.push_back(1 + 0.25f * static_cast<float>(i % 100));
  all[3] = 0, all[4] = -2, all[5] = std::numeric_limits<float>::quiet_NaN();
  all[6] = std::numeric_limits<float>::infinity();
  return all;
}

std::string as_bytes(const std::vector<float>& numbers) {
  std::string bytes(numbers.size() * sizeof(float), '\0');
  std::memcpy(bytes.data(), numbers.data(), bytes.size());
  return bytes;
}

/// As numpy.save writes it.
std::string npy(const std::string& descr, const std::string& order, const std::string& shape, const std::string& data) {
  std::string header = "{'descr': '" + descr + "', 'fortran_order': " + order + ", 'shape': " + shape + ", }";
  header.resize(118 - 1, ' ');
  header += '\n';
  return std::string("\x93NUMPY\x01\x00\x76\x00", 10) + header + data;
}

struct Folder {
  void write(const std::string& name, const std::string& bytes) const {
    std::ofstream(folder.path() / name, std::ios::binary) << bytes;
  }
  [[nodiscard]] Result<DepthMap> read(const std::string& name, DepthKind kind, std::optional<double> scale = {},
                                      std::optional<double> baseline_m = {}) const {
    return read_depth({folder.path(), kind, scale}, name, camera(), baseline_m);
  }
  test::TemporaryFolder folder;
};

void check_is_inverse_of(const DepthMap& map, const std::vector<float>& depth) {
  REQUIRE(map.width == width);
  REQUIRE(map.inverse_depth.size() == depth.size());
  for (std::size_t i = 0; i < depth.size(); ++i) {
    if (i >= 3 && i <= 6)
      CHECK(map.inverse_depth[i] == DepthMap::no_depth);
    else
      REQUIRE(map.inverse_depth[i] == Approx(1 / depth[i]).epsilon(1e-6));
  }
}

}  // namespace

TEST_CASE("depth of every format becomes inverse depth, and what is no depth is none") {
  const Folder folder;
  cv::Mat floats(height, width, CV_32FC1);
  std::ranges::copy(values(), floats.begin<float>());
  REQUIRE(cv::imwrite((folder.folder.path() / "t.tiff").string(), floats));
  // PFM by hand: rows from the bottom up; a negative scale means little-endian.
  std::vector<float> flipped;
  for (int y = height - 1; y >= 0; --y)
    flipped.insert(flipped.end(), floats.ptr<float>(y), floats.ptr<float>(y) + width);
  folder.write("p.pfm", "Pf\n32 16\n-1.0\n" + as_bytes(flipped));
  folder.write("n.npy", npy("<f4", "False", "(16, 32)", as_bytes(values())));
  for (const char* name : {"t", "p", "n"}) {
    INFO(name);
    const auto map = test::require_ok(folder.read(name, DepthKind::depth));
    check_is_inverse_of(map, values());
    CHECK_FALSE(map.along_ray);
    CHECK(test::require_ok(folder.read(name, DepthKind::range)).along_ray);
    CHECK(test::require_ok(folder.read(name, DepthKind::depth, 10)).inverse_depth[0] == Approx(10));
    CHECK(test::require_ok(folder.read(name, DepthKind::inverse)).inverse_depth[7] == Approx(2.75));
  }
}

TEST_CASE("a 16-bit PNG has 256 steps a unit unless told otherwise, and a disparity is metric by the baseline") {
  const Folder folder;
  cv::Mat_<std::uint16_t> pixels(height, width, std::uint16_t{0});
  pixels(2, 3) = 1280;  // 5
  REQUIRE(cv::imwrite((folder.folder.path() / "a.png").string(), pixels));
  const auto at = [&](const Result<DepthMap>& map) { return test::require_ok(map).inverse_depth[2 * width + 3]; };
  CHECK(at(folder.read("a", DepthKind::depth)) == Approx(0.2));
  CHECK(at(folder.read("a", DepthKind::depth, 1000)) == Approx(1 / 1.28));
  CHECK(at(folder.read("a", DepthKind::disparity)) == Approx(5));
  // z = f B / d = 20 * 0.5 / 5 = 2 m.
  CHECK(at(folder.read("a", DepthKind::disparity, {}, 0.5)) == Approx(0.5));
  CHECK(std::ranges::count(folder.read("a", DepthKind::disparity)->inverse_depth, DepthMap::no_depth) ==
        width * height - 1);
}

TEST_CASE("a map of half the image's size is widened without inventing depths between, another shape is refused") {
  const Folder folder;
  std::vector<float> half(16 * 8, 2.f);
  half[0] = 4;
  folder.write("half.npy", npy("<f4", "False", "(8, 16)", as_bytes(half)));
  const auto map = test::require_ok(folder.read("half", DepthKind::depth));
  REQUIRE(map.width == width);
  CHECK(map.inverse_depth[0] == 0.25f);
  CHECK(map.inverse_depth[width + 1] == 0.25f);
  CHECK(std::ranges::count(map.inverse_depth, 0.25f) == 4);
  CHECK(std::ranges::count(map.inverse_depth, 0.5f) == width * height - 4);
  // Two pixels of disparity in a map of half the width are four in the image: z = 20 * 0.5 / 4.
  CHECK(test::require_ok(folder.read("half", DepthKind::disparity, {}, 0.5)).inverse_depth.back() == Approx(0.4));

  folder.write("tall.npy", npy("<f4", "False", "(16, 16)", as_bytes(std::vector<float>(256, 1.f))));
  const auto tall = folder.read("tall", DepthKind::depth);
  REQUIRE_FALSE(tall);
  CHECK(tall.error().code == "depth_unreadable");
  CHECK(tall.error().context.find("16 x 16, which is not the shape of the image, 32 x 16") != std::string::npos);
}

TEST_CASE("a depth file that is missing, of another type or without depth says so") {
  const Folder folder;
  const auto missing = folder.read("0000000007", DepthKind::depth);
  REQUIRE_FALSE(missing);
  CHECK(missing.error().code == "depth_missing");
  CHECK(missing.error().context.find("frame 0000000007") != std::string::npos);

  const std::string data = as_bytes(values());
  int count = 0;
  for (const std::string& bytes :
       {std::string("no array"), npy("<f8", "False", "(16, 32)", data), npy(">f4", "False", "(16, 32)", data),
        npy("<f4", "True", "(16, 32)", data), npy("<f4", "False", "(16, 32, 1)", data),
        npy("<f4", "False", "(512,)", data), npy("<f4", "False", "(-16, -32)", data),
        npy("<f4", "False", "(16, 32)", data.substr(4)), npy("<f4", "False", "(65536, 65536)", data),
        std::string("\x93NUMPY\x02\x00\xff\xff\xff\xff", 12)}) {
    const std::string name = "npy" + std::to_string(count++);
    INFO(name);
    folder.write(name + ".npy", bytes);
    CHECK(folder.read(name, DepthKind::depth).error().code == "depth_unreadable");
  }
  REQUIRE(cv::imwrite((folder.folder.path() / "eight.png").string(), cv::Mat(height, width, CV_8UC1, cv::Scalar(7))));
  CHECK(folder.read("eight", DepthKind::depth).error().code == "depth_unreadable");
  folder.write("text.png", "not a picture");
  CHECK(folder.read("text", DepthKind::depth).error().code == "depth_unreadable");
  REQUIRE(cv::imwrite((folder.folder.path() / "black.png").string(), cv::Mat(height, width, CV_16UC1, cv::Scalar(0))));
  CHECK(folder.read("black", DepthKind::depth).error().code == "depth_empty");

  CHECK(parse_depth_kind("range") == DepthKind::range);
  CHECK(parse_depth_kind("Disparity").error().code == "unknown_depth_kind");
}

TEST_CASE("a depth file that claims more than it holds is refused before memory is taken for it") {
  const Folder folder;
  folder.write("claims.npy", npy("<f4", "False", "(65536, 65536)", "data").substr(0, 100 + 32));
  const auto claims = folder.read("claims", DepthKind::depth);
  REQUIRE_FALSE(claims);
  CHECK(claims.error().context ==
        (folder.folder.path() / "claims.npy").string() + " does not hold as many values as its shape says");
  // A PNG of 65536 x 65536 pixels, as far as its header.
  folder.write("bomb.png", std::string("\x89PNG\r\n\x1a\n\0\0\0\rIHDR\0\1\0\0\0\1\0\0\x10\0\0\0\0", 29) +
                               std::string("\0\0\0\0", 4));
  const auto bomb = folder.read("bomb", DepthKind::depth);
  REQUIRE_FALSE(bomb);
  CHECK(bomb.error().code == "depth_unreadable");
  CHECK(bomb.error().context.find("bomb.png is 65536 x 65536 pixels") != std::string::npos);

  folder.write("long.npy", "");
  fs::resize_file(folder.folder.path() / "long.npy", (std::uintmax_t{256} << 20) + 1);  // takes no room on disk
  CHECK(folder.read("long", DepthKind::depth).error().context.find("is larger than 256 MiB") != std::string::npos);
}

TEST_CASE("ranges read back within half a step of 4 mm, and the sky as none") {
  const Folder folder;
  std::vector<float> range(width * height, 12.3456f);
  range[0] = std::numeric_limits<float>::infinity(), range[1] = 300, range[2] = 255.9f;
  test::require_ok(write_range_png(folder.folder.path() / "a.png", width, height, range));
  const auto map = test::require_ok(folder.read("a", DepthKind::range));
  CHECK(map.inverse_depth[0] == 0);
  CHECK(map.inverse_depth[1] == 0);
  CHECK(1 / map.inverse_depth[2] == Approx(255.9).margin(0.002));
  CHECK(1 / map.inverse_depth.back() == Approx(12.3456).margin(0.002));
  CHECK(write_range_png(folder.folder.path() / "none/a.png", width, height, range).error().code == "write_failed");
}

TEST_CASE("a smooth bias is as large as asked, smooth, the same for a seed, and leaves pixels without depth alone") {
  DepthMap flat;
  flat.width = 64, flat.height = 32;
  flat.inverse_depth.assign(64 * 32, 0.1f);
  flat.inverse_depth[100] = 0;
  for (const std::uint64_t seed : {1, 2, 3}) {
    DepthMap biased = flat, again = flat, other = flat;
    add_smooth_bias(biased, 0.3, seed);
    add_smooth_bias(again, 0.3, seed);
    add_smooth_bias(other, 0.3, seed + 10);
    CHECK(biased.inverse_depth == again.inverse_depth);
    CHECK(biased.inverse_depth != other.inverse_depth);
    CHECK(biased.inverse_depth[100] == 0);
    double largest = 0, roughest = 0;
    const auto f = [&](int i) { return 0.1 / biased.inverse_depth[i] - 1; };
    for (int i = 0; i < 64 * 32; ++i) {
      if (i == 100) continue;
      largest = std::max(largest, std::abs(f(i)));
      if (i % 64 != 0 && i != 101) roughest = std::max(roughest, std::abs(f(i) - f(i - 1)));
    }
    CHECK(largest == Approx(0.3).epsilon(1e-4));
    // |df/du| <= 9 max |f| on [-1, 1] for degree 3 (Markov), and a pixel is 2 / 64 of it.
    CHECK(roughest < 9 * 0.3 * 2 / 64);
  }
}
