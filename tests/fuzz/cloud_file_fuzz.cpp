#include "dataset/cloud_file.hpp"

#include <cmath>
#include <optional>

#include "fuzz/fuzz.hpp"
#include "fuzz/scratch.hpp"

namespace calib::fuzz {

std::vector<Octets> seeds() {
  const auto seed = [](std::uint8_t pcd, const std::string& content) {
    return Output().put(pcd).with(octets(content));
  };
  const std::string one = std::string("\0\0\x80\x3f", 4), point = one + one + one + one;
  const std::string header =
      "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z intensity\nSIZE 4 4 4 4\nTYPE F F F F\nCOUNT 1 1 1 1\n"
      "WIDTH 2\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 2\n";
  return {seed(0, point + point),
          seed(1, header + "DATA binary\n" + point + point),
          seed(1, header + "DATA ascii\n1 2 3 0.5\n-1.5 2e1 nan 7\n"),
          seed(1, header + "DATA binary_compressed\n" + std::string("\x21\0\0\0\x20\0\0\0\x1f", 9) + point + point),
          seed(1, header + "DATA binary_compressed\n" + std::string("\5\0\0\0\x20\0\0\0\0@\xe0\x16\0", 13)),
          seed(2, point + point + point + point + point),
          seed(4, point + point + point),
          seed(1, "FIELDS x y z ring reflectance\nSIZE 8 8 8 2 1\nTYPE F F F U U\nPOINTS 1\nDATA binary\n" + point +
                      point)};
}

}  // namespace calib::fuzz

/// Whether it is a .pcd, and what layout is stated, then the file.
int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t size) {
  calib::fuzz::Input input(bytes, size);
  const auto choice = input.take<std::uint8_t>();
  const std::string name = choice % 2 == 1 ? "cloud.pcd" : "cloud.bin";
  std::optional<calib::CloudLayout> layout;
  if (choice / 2 % 3 == 1) layout = {calib::CloudLayout::Scalar::float32, 5};
  if (choice / 2 % 3 == 2) layout = {calib::CloudLayout::Scalar::float64, 3};
  const calib::fuzz::Octets file = input.rest();
  const auto scan = calib::read_cloud(calib::fuzz::scratch().write(name, calib::fuzz::text(file)), layout);
  if (!scan) {
    calib::fuzz::require_code(scan.error(), {calib::ErrorCode::cloud_unreadable, calib::ErrorCode::cloud_layout,
                                             calib::ErrorCode::cloud_empty});
    return 0;
  }
  calib::fuzz::require(!scan->points.empty() && scan->points.size() <= 100 * file.size());  // LZF
  for (const calib::LidarPoint& point : scan->points)
    calib::fuzz::require(std::hypot(point.x_m, point.y_m, point.z_m) < 500.001F && std::isfinite(point.reflectance));
  return 0;
}
