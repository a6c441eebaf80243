#include "dataset/list_writer.hpp"

#include <algorithm>
#include <iomanip>
#include <span>
#include <sstream>

#include "calib/file.hpp"
#include "dataset/cloud_file.hpp"
#include "dataset/depth_files.hpp"
#include "dataset/image_file.hpp"

namespace calib {
namespace {

namespace fs = std::filesystem;

tl::unexpected<Error> write_failed(const fs::path& path) {
  return fail(ErrorCode::write_failed, path.string() + " cannot be written");
}

void write_list(std::ostream& out, const char* key, std::span<const double> values) {
  out << key << ": [";
  for (std::size_t i = 0; i < values.size(); ++i) out << (i == 0 ? "" : ", ") << values[i];
  out << ']';
}

}  // namespace

Result<ListWriter> ListWriter::create(const fs::path& folder, const Camera& camera,
                                      const RigidTransform& T_camera_lidar) {
  std::error_code error;
  for (const char* name : {"images", "clouds", "depth"})
    if (fs::create_directories(folder / name, error); error) return write_failed(folder / name);

  std::ostringstream out;
  out.imbue(std::locale::classic());
  out << std::setprecision(17) << "camera: {model: " << to_string(camera.model()) << ", size: [" << camera.width()
      << ", " << camera.height() << "], ";
  write_list(out, "intrinsics", std::array{camera.fx(), camera.fy(), camera.cx(), camera.cy()});
  if (!camera.distortion().empty()) write_list(out << ", ", "distortion", camera.distortion());
  write_list(out << "}\nT_camera_lidar: {", "translation_m", translation_m(T_camera_lidar));
  write_list(out << ", ", "quaternion_xyzw", quaternion_xyzw(T_camera_lidar));
  out << "}\nimages: images\nclouds: clouds\n";
  const auto written = replace_file(folder / "recording.yaml", out.str());
  return written.map([&] { return ListWriter(folder); });
}

Result<void> ListWriter::append(const Image& image, const LidarScan& scan, const std::vector<float>& range_m) {
  std::string name = std::to_string(count_++);
  name.insert(0, 6 - std::min<std::size_t>(name.size(), 6), '0');
  if (const auto written = write_image(folder_ / "images" / (name + ".png"), image); !written) return written;
  if (const auto written = write_cloud(folder_ / "clouds" / (name + ".bin"), scan); !written) return written;
  const auto depth = folder_ / "depth" / (name + ".png");
  if (range_m.empty()) return {};
  if (const auto written = write_range_png(depth, image.width, image.height, range_m); !written) return written;
  return {};
}

}  // namespace calib
