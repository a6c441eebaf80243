#include "dataset/cloud_file.hpp"

#include <cmath>
#include <cstring>
#include <fstream>
#include <limits>

#include "support/catch.hpp"
#include "support/support.hpp"

using namespace calib;
namespace fs = std::filesystem;

namespace {

/// A file of the given name with the given bytes, in a folder of its own.
class CloudFile {
 public:
  CloudFile(const char* name, const std::string& bytes) : path_(folder_.path() / name) {
    std::ofstream(path_, std::ios::binary) << bytes;
  }
  [[nodiscard]] Result<LidarScan> read(const std::optional<CloudLayout>& layout = {}) const {
    return read_cloud(path_, layout);
  }

 private:
  test::TemporaryFolder folder_;
  fs::path path_;
};

template <typename... T>
std::string bytes_of(T... values) {
  std::string bytes;
  const auto append = [&bytes](auto value) {
    char raw[sizeof value];
    std::memcpy(raw, &value, sizeof value);
    bytes.append(raw, sizeof value);
  };
  (append(values), ...);
  return bytes;
}

std::string header(const std::string& data, int points,
                   const std::string& fields = "FIELDS x y z intensity\nSIZE 4 4 4 4\nTYPE F F F F\nCOUNT 1 1 1 1\n") {
  return "# .PCD v0.7\nVERSION 0.7\n" + fields + "WIDTH " + std::to_string(points) +
         "\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS " + std::to_string(points) + "\nDATA " + data + "\n";
}

/// x, y, z and so many more, each of `count` values.
std::string many_fields(int more, const std::string& count) {
  std::string names = "FIELDS x y z", sizes = "SIZE 4 4 4", types = "TYPE F F F", counts = "COUNT 1 1 1";
  for (int i = 0; i < more; ++i) names += " f", sizes += " 4", types += " F", counts += ' ' + count;
  return names + '\n' + sizes + '\n' + types + '\n' + counts + '\n';
}

constexpr float not_a_number = std::numeric_limits<float>::quiet_NaN();

}  // namespace

TEST_CASE("a .bin holds points of four floats; those that are no return are left out") {
  const auto scan = CloudFile("a.bin", bytes_of(1.f, 2.f, 3.f, 0.5f, not_a_number, 0.f, 0.f, 0.f, 0.f, 0.f, 0.f, 0.3f,
                                                600.f, 0.f, 0.f, 0.f, 4.f, 5.f, 6.f, not_a_number))
                        .read();
  REQUIRE(scan);
  REQUIRE(scan->points.size() == 2);
  CHECK(scan->points[0].z_m == 3);
  CHECK(scan->points[0].reflectance == 0.5f);
  CHECK(scan->points[1].x_m == 4);
  CHECK(scan->points[1].reflectance == 0);
}

TEST_CASE("an ASCII .pcd is read by the names of its fields") {
  const auto scan = CloudFile("a.pcd", header("ascii", 3,
                                              "FIELDS intensity z normal y x\nSIZE 4 4 4 4 4\nTYPE F F F F F\nCOUNT 1 "
                                              "1 2 1 1\n") +
                                           "0.5 3 9 9 2 1\r\n0 nan 9 9 nan nan\n7e1 -6 9 9 5.5 4\n")
                        .read();
  REQUIRE(scan);
  REQUIRE(scan->points.size() == 2);
  CHECK(scan->points[0].x_m == 1);
  CHECK(scan->points[0].y_m == 2);
  CHECK(scan->points[0].z_m == 3);
  CHECK(scan->points[0].reflectance == 0.5f);
  CHECK(scan->points[1].y_m == 5.5f);
  CHECK(scan->points[1].z_m == -6);
  CHECK(scan->points[1].reflectance == 70);
}

TEST_CASE("a binary .pcd is read whatever types its fields have") {
  const auto plain =
      CloudFile("a.pcd", header("binary", 2) + bytes_of(1.f, 2.f, 3.f, 0.5f, 4.f, 5.f, 6.f, 0.25f)).read();
  REQUIRE(plain);
  REQUIRE(plain->points.size() == 2);
  CHECK(plain->points[1].x_m == 4);
  CHECK(plain->points[1].reflectance == 0.25f);

  const auto mixed =
      CloudFile("a.pcd", header("binary", 2, "FIELDS t x y z reflectivity\nSIZE 8 8 8 8 2\nTYPE F F F F U\n") +
                             bytes_of(0.1, 1., 2., 3.) + bytes_of(std::uint16_t{60000}) + bytes_of(0.2, 4., 5., 6.) +
                             bytes_of(std::uint16_t{7}))
          .read();
  REQUIRE(mixed);
  REQUIRE(mixed->points.size() == 2);
  CHECK(mixed->points[0].y_m == 2);
  CHECK(mixed->points[0].reflectance == 60000);
  CHECK(mixed->points[1].z_m == 6);

  const auto bare =
      CloudFile("a.pcd", header("binary", 1, "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\n") + bytes_of(1.f, 2.f, 3.f))
          .read();
  REQUIRE(bare);
  CHECK(bare->points.at(0).reflectance == 0);
}

TEST_CASE("a cloud that cannot be read says why") {
  struct Case {
    const char *name, *part;
    std::string bytes;
  };
  for (const auto& [name, part, bytes] :
       {Case{"a.las", "neither .bin nor .pcd", "LASF"},
        Case{"a.pcd", "no whole PCD header", "something else"},
        Case{"a.pcd", "no fields x, y and z", header("ascii", 1, "FIELDS x y\nSIZE 4 4\nTYPE F F\n") + "1 2\n"},
        Case{"a.pcd", "impossible size", header("binary", 1, "FIELDS x y z\nSIZE 4 99 4\nTYPE F F F\n") + "xxxx"},
        Case{"a.pcd", "x of an unknown type", header("binary", 1, "FIELDS x y z\nSIZE 3 4 4\nTYPE F F F\n") + "xxxx"},
        Case{"a.pcd", "x of an unknown type",
             header("binary", 1, "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 0 0 0\n") + "xxxx"},
        Case{"a.pcd", "ends before its last point", header("binary", 2) + bytes_of(1.f, 2.f, 3.f, 0.5f)},
        Case{"a.pcd", "ends before its last point", header("binary", 2'000'000'000)},
        Case{"a.pcd", "ends before its last point", header("ascii", 2) + "1 2 3 4\n"},
        Case{"a.pcd", "no point: 1 2", header("ascii", 1) + "1 2\n"},
        Case{"a.pcd", "none of ascii, binary and binary_compressed", header("binary_zstd", 1) + "xxxxxxxxxxxx"},
        Case{"a.pcd", "of 2021161080 bytes, where its header has 1 points of 16",
             header("binary_compressed", 1) + bytes_of(4U) + "xxxxxxxxxxxx"},
        Case{"a.pcd", "does not decompress", header("binary_compressed", 1) + bytes_of(4U, 16U) + "\x40\x40\x40\x40"},
        Case{"a.pcd", "ends before its last point", header("binary_compressed", 1) + bytes_of(5U, 16U) + "xxxx"},
        Case{"a.pcd", "the line SIZE is missing", "FIELDS x y z\nTYPE F F F\nPOINTS 1\nDATA ascii\n1 2 3\n"},
        Case{"a.pcd", "TYPE has 2 values for 3 FIELDS",
             "FIELDS x y z\nSIZE 4 4 4\nTYPE F F\nPOINTS 1\nDATA ascii\n1 2 3\n"},
        Case{"a.pcd", "the line POINTS is missing", "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nDATA ascii\n1 2 3\n"},
        Case{"a.pcd", "the line DATA is missing", "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nPOINTS 1\n"},
        Case{"a.pcd", "no point: 1 2 3,5 4", header("ascii", 1) + "1 2 3,5 4\n"},
        Case{"a.pcd", "no whole PCD header", header("ascii", 1, many_fields(200'000, "1")) + "1\n"},
        Case{"a.pcd", "more than 8192 values", header("ascii", 1, many_fields(1000, "4000")) + "1\n"},
        Case{"a.pcd", "more than 8192 values", header("binary", 1, many_fields(1000, "4000")) + "1\n"},
        Case{"a.pcd", "impossible size", header("ascii", 1, many_fields(4, "18446744073709551615")) + "1\n"},
        Case{"a.pcd", "no whole PCD header", "FIELDS " + std::string(1'000'000, 'x') + "\nDATA ascii\n"}}) {
    INFO(part);
    const auto scan = CloudFile(name, bytes).read();
    REQUIRE_FALSE(scan);
    INFO(scan.error().context);
    CHECK(scan.error().code == "cloud_unreadable");
    CHECK(scan.error().context.find(part) != std::string::npos);
    CHECK(scan.error().context.size() < 1000);
  }
  const auto line = CloudFile("a.pcd", header("ascii", 1) + std::string(100'000, '\x1b') + "\n").read();
  REQUIRE_FALSE(line);
  CHECK(line.error().context.size() < 1000);
  CHECK(read_cloud("no/such.bin").error().code == "cloud_unreadable");
}

TEST_CASE("a .bin is read by the layout that is stated") {
  const auto five = CloudFile("a.bin", bytes_of(1.f, 2.f, 3.f, 9.f, 31.f, 4.f, 5.f, 6.f, 8.f, 30.f))
                        .read(CloudLayout{CloudLayout::Scalar::float32, 5});
  REQUIRE(five);
  REQUIRE(five->points.size() == 2);
  CHECK(five->points[1].x_m == 4);
  CHECK(five->points[1].reflectance == 8);
  const auto doubles =
      CloudFile("a.bin", bytes_of(1., 2., 3., 4., 5., 6.)).read(CloudLayout{CloudLayout::Scalar::float64, 3});
  REQUIRE(doubles);
  REQUIRE(doubles->points.size() == 2);
  CHECK(doubles->points[1].z_m == 6);
  CHECK(doubles->points[1].reflectance == 0);
  const auto wrong = CloudFile("a.bin", std::string(20, 'a')).read();
  REQUIRE_FALSE(wrong);
  CHECK(wrong.error().code == ErrorCode::cloud_unreadable);
  CHECK(wrong.error().context.find("does not hold whole points of 4 floats of 32 bits a point (float32x4)") !=
        std::string::npos);
  CHECK(wrong.error().context.find("cloud_layout in a list, or --cloud-layout") != std::string::npos);
}

TEST_CASE("a .bin of a stated layout that it does not look like is read, with a remark") {
  std::string bytes;
  for (int i = 0; i < 2000; ++i) {
    const float angle = 0.003F * static_cast<float>(i), range = 5 + 3 * std::sin(0.1F * static_cast<float>(i));
    bytes += bytes_of(range * std::cos(angle), range * std::sin(angle), -1.5F, 0.3F, static_cast<float>(i % 32));
  }
  const CloudFile file("a.bin", bytes);
  const auto right = file.read(CloudLayout{CloudLayout::Scalar::float32, 5});
  REQUIRE(right);
  CHECK(right->notes.remarks.empty());
  const auto wrong = file.read(CloudLayout{CloudLayout::Scalar::float32, 4});
  REQUIRE(wrong);
  REQUIRE(wrong->notes.remarks.size() == 1);
  CHECK(wrong->notes.remarks[0].code == ErrorCode::cloud_layout);
}

TEST_CASE("a .pcd whose numbers are not what its header says is refused") {
  std::string bytes;
  for (int i = 0; i < 40; ++i) bytes += bytes_of(1.5 + i / 7., 2.5 - i / 9., 0.3 * i, 0.1);
  const auto wrong = CloudFile("a.pcd", header("binary", 80) + bytes).read();
  REQUIRE_FALSE(wrong);
  CHECK(wrong.error().code == ErrorCode::cloud_layout);
}

TEST_CASE("a compressed .pcd holds its fields one after the other, without padding") {
  // Runs of bytes that are taken as they are.
  const std::string values = bytes_of(1.f, 4.f) + bytes_of(2.f, 5.f) + bytes_of(3.f, 3.f) + std::string("\7\7");
  std::string packed = "\x17" + values.substr(0, 24) + std::string("\x00\x07\x00\x07", 4);
  const std::string fields = "FIELDS x y _ z intensity\nSIZE 4 4 1 4 1\nTYPE F F U F U\nCOUNT 1 1 4 1 1\n";
  const auto size = [](std::size_t bytes) { return bytes_of(static_cast<std::uint32_t>(bytes)); };
  const auto scan =
      CloudFile("a.pcd", header("binary_compressed", 2, fields) + size(packed.size()) + size(values.size()) + packed)
          .read();
  REQUIRE(scan);
  REQUIRE(scan->points.size() == 2);
  CHECK(scan->points[1].x_m == 4);
  CHECK(scan->points[0].y_m == 2);
  CHECK(scan->points[1].z_m == 3);
  CHECK(scan->points[1].reflectance == 7);

  // One literal byte, then eleven more like it: a length of 7 in the control byte is extended.
  const std::string same("\x00@\xe0\x02\x00", 5);
  const auto constant = CloudFile("a.pcd", header("binary_compressed", 1, "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\n") +
                                               size(same.size()) + size(12) + same)
                            .read();
  REQUIRE(constant);
  CHECK(constant->points.at(0).z_m == Approx(3.0039));  // 0x40404040
}

TEST_CASE("an ASCII .pcd may have plus signs and what C libraries print for numbers that are none") {
  const auto scan = CloudFile("a.pcd", header("ascii", 4) +
                                           "+1.0 -2 3 +4e+0\n-1.#IND -1.#IND 1.#QNAN 0\n1 1 1 1.#INF\n1e-999 1 1 0\n")
                        .read();
  REQUIRE(scan);
  REQUIRE(scan->points.size() == 2);
  CHECK(scan->points[0].x_m == 1);
  CHECK(scan->points[0].reflectance == 4);
  CHECK(scan->points[1].reflectance == 0);
}

TEST_CASE("the first of the names of reflectance is read, and one of an unknown type is left out") {
  const auto two = CloudFile("a.pcd", header("ascii", 1, "FIELDS i x y z intensity\nSIZE 4 4 4 4 4\nTYPE F F F F F\n") +
                                          "8 1 2 3 9\n")
                       .read();
  REQUIRE(two);
  CHECK(two->points.at(0).reflectance == 9);
  const auto odd =
      CloudFile("a.pcd", header("ascii", 1, "FIELDS x y z intensity\nSIZE 4 4 4 3\nTYPE F F F U\n") + "1 2 3 9\n")
          .read();
  REQUIRE(odd);
  CHECK(odd->points.at(0).reflectance == 0);
  REQUIRE(odd->notes.remarks.size() == 1);
  CHECK(odd->notes.remarks[0].context == "the field intensity of an unknown type is left out");
}

TEST_CASE("POINTS is redundant where WIDTH and HEIGHT are there") {
  const auto scan =
      CloudFile("a.pcd", "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH 1\nHEIGHT 2\nDATA ascii\n1 2 3\n4 5 6\n").read();
  REQUIRE(scan);
  CHECK(scan->points.size() == 2);
}

TEST_CASE("a cloud without a point is empty") {
  CHECK(CloudFile("a.bin", "").read().error().code == "cloud_empty");
  CHECK(CloudFile("a.pcd", header("ascii", 0)).read().error().code == "cloud_empty");
  CHECK(CloudFile("a.pcd", header("ascii", 1) + "0 0 0 1\n").read().error().code == "cloud_empty");
}
