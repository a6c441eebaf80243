#include "calib/cloud_layout.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <random>
#include <set>
#include <vector>

#include "support/catch.hpp"
#include "support/support.hpp"

using namespace calib;
using Catch::Matchers::ContainsSubstring;

namespace {

using Row = std::vector<double>;

/// x, y, z, intensity, ring, time of 32 rings at 180 azimuths between walls, over a road.
std::vector<Row> street() {
  std::vector<Row> rows;
  std::mt19937 random(7);
  for (int azimuth = 0; azimuth < 180; ++azimuth)
    for (int ring = 0; ring < 32; ++ring) {
      const double a = 0.0349 * azimuth, elevation = -0.4 + 0.016 * ring;
      const double wall = 4 + 3 * (azimuth / 20 % 5) + 1e-3 * static_cast<double>(random() % 100);
      const double range = elevation < 0 ? std::min(wall, -1.8 / std::sin(elevation)) : wall;
      rows.push_back({range * std::cos(elevation) * std::cos(a), range * std::cos(elevation) * std::sin(a),
                      range * std::sin(elevation), static_cast<double>(random() % 256), static_cast<double>(ring),
                      azimuth * 5.5e-4});
    }
  return rows;
}

template <typename T>
std::string written(const std::vector<Row>& rows, std::size_t columns) {
  std::string bytes;
  for (const Row& row : rows)
    for (std::size_t column = 0; column < columns; ++column) {
      const T value = static_cast<T>(row[column]);
      bytes.append(reinterpret_cast<const char*>(&value), sizeof value);
    }
  return bytes;
}

std::string objection(const std::string& bytes, const CloudLayout& layout = {}, LayoutIs known = LayoutIs::assumed) {
  const auto checked = check_cloud_layout(bytes, layout, known);
  if (checked) return "";
  CHECK(checked.error().code == (bytes.size() < 100 ? ErrorCode::cloud_unreadable : ErrorCode::cloud_layout));
  return checked.error().context;
}

}  // namespace

TEST_CASE("a cloud of another number of columns is told from one of four floats, in any order of its points") {
  auto rows = street();
  for (const bool shuffled : {false, true}) {
    if (shuffled) std::shuffle(rows.begin(), rows.end(), std::mt19937(3));
    INFO("shuffled " << shuffled);
    CHECK(objection(written<float>(rows, 4)).empty());
    CHECK_THAT(
        objection(written<float>(rows, 5)),
        ContainsSubstring("it looks like 5 floats of 32 bits a point (float32x5), of which number 5 counts rings"));
    CHECK_THAT(objection(written<float>(rows, 6)), ContainsSubstring("(float32x6), of which number 5 counts rings"));
    CHECK_THAT(objection(written<float>(rows, 3)),
               ContainsSubstring("it looks like 3 floats of 32 bits a point (float32x3)"));
    CHECK_THAT(objection(written<double>(rows, 4)),
               ContainsSubstring("it looks like 4 floats of 64 bits a point (float64x4)"));
    CHECK_THAT(objection(written<double>(rows, 4)),
               ContainsSubstring("% of the points have a coordinate that no LiDAR measures"));
    CHECK_THAT(objection(written<double>(rows, 3)), ContainsSubstring("(float64x3)"));
  }
}

TEST_CASE("a cloud without reflectance, or with one in whole numbers, is one of four floats") {
  auto rows = street();
  for (Row& row : rows) row[3] = 0;
  CHECK(objection(written<float>(rows, 4)).empty());
  for (Row& row : rows) row[3] = row[4];
  CHECK(objection(written<float>(rows, 4)).empty());
  for (std::size_t i = 0; i < rows.size(); i += 2) rows[i] = {NAN, NAN, NAN, 0, 0, 0};
  CHECK(objection(written<float>(rows, 4)).empty());
}

TEST_CASE("a layout that was stated is believed, unless the bytes cannot be points of it") {
  const auto rows = street();
  for (const std::size_t columns : {3U, 4U, 5U, 6U}) {
    CHECK(objection(written<float>(rows, columns), {CloudLayout::Scalar::float32, columns}, LayoutIs::stated).empty());
    CHECK(objection(written<double>(rows, columns), {CloudLayout::Scalar::float64, columns}, LayoutIs::stated).empty());
  }
  CHECK_THAT(objection(written<double>(rows, 4), {CloudLayout::Scalar::float32, 4}, LayoutIs::stated),
             ContainsSubstring("(float64x4)"));
  CHECK_THAT(objection(std::string(20, 'a'), {CloudLayout::Scalar::float32, 4}, LayoutIs::stated),
             ContainsSubstring("whole points"));
}

TEST_CASE("in few numbers no other layout is looked for") {
  auto rows = street();
  rows.resize(100);
  CHECK(objection(written<float>(rows, 5)).find("looks like") == std::string::npos);
  CHECK(objection("").empty());
}

TEST_CASE("a layout is written as its type and its columns") {
  CHECK(to_string(CloudLayout{}) == "float32x4");
  CHECK(test::require_ok(parse_cloud_layout("float64x16")) == CloudLayout{CloudLayout::Scalar::float64, 16});
  for (const char* word : {"", "float32", "float32x2", "float32x17", "float16x4", "xyzi", "float32x4 ", "\x1b[2J"}) {
    const auto refused = parse_cloud_layout(word);
    REQUIRE_FALSE(refused);
    CHECK(refused.error().context.find('\x1b') == std::string::npos);
  }
}

TEST_CASE("a sampling step shares no factor with rings or columns") {
  CHECK(sampling_step(131'072, 2048, {2048, 64}) == 67);
  CHECK(sampling_step(2048, 2048, {64}) == 1);
  CHECK(sampling_step(0, 2048, {0}) == 1);
  CHECK(sampling_step(9000, 3000, {3}) == 5);
  CHECK(sampling_step(9000, 3000, {0}) == 3);
  std::set<std::uint64_t> rings;
  for (std::uint64_t i = 0; i < 131'072; i += 67) rings.insert(i % 64);
  CHECK(rings.size() == 64);
}
