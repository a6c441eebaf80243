#include "dataset/cloud_file.hpp"

#include <algorithm>
#include <cstring>
#include <string>

#include "calib/file.hpp"
#include "dataset/cloud_points.hpp"
#include "dataset/extension.hpp"
#include "dataset/pcd_file.hpp"

namespace calib {
namespace {

namespace fs = std::filesystem;

template <typename T>
LidarScan read_points(std::string_view bytes, std::size_t columns) {
  CloudPoints points;
  points.scan().points.reserve(bytes.size() / (columns * sizeof(T)));
  for (std::size_t at = 0; at < bytes.size(); at += columns * sizeof(T)) {
    T point[4] = {};
    std::memcpy(point, bytes.data() + at, std::min<std::size_t>(columns, 4) * sizeof(T));
    points.add(point[0], point[1], point[2], point[3]);
  }
  return std::move(points.scan());
}

Result<LidarScan> read_bin(std::string_view bytes, const fs::path& path, const std::optional<CloudLayout>& stated) {
  const CloudLayout layout = stated.value_or(CloudLayout{});
  if (const auto fits = check_cloud_layout(bytes, layout, stated ? LayoutIs::stated : LayoutIs::assumed); !fits)
    return fail(fits.error().code, path.string() + ' ' + fits.error().context +
                                       "; say how it is written: cloud_layout in a list, or --cloud-layout");
  LidarScan scan = layout.scalar == CloudLayout::Scalar::float32 ? read_points<float>(bytes, layout.columns)
                                                                 : read_points<double>(bytes, layout.columns);
  // What somebody has stated is believed, and the doubt is told.
  if (stated)
    if (const auto fits = check_cloud_layout(bytes, layout, LayoutIs::assumed); !fits)
      scan.notes.remarks.push_back(fits.error());
  return scan;
}

}  // namespace

Result<LidarScan> read_cloud(const fs::path& path, const std::optional<CloudLayout>& layout) {
  constexpr std::uint64_t most_bytes = 256 << 20;
  const bool pcd = extension_of(path) == ".pcd";
  if (!pcd && extension_of(path) != ".bin")
    return fail(ErrorCode::cloud_unreadable, path.string() + " is neither .bin nor .pcd");
  const auto bytes = read_regular_file(path, most_bytes);
  if (!bytes) return fail(ErrorCode::cloud_unreadable, bytes.error().context);
  auto scan = pcd ? read_pcd(*bytes, path) : read_bin(*bytes, path, layout);
  if (scan && scan->points.empty()) return fail(ErrorCode::cloud_empty, path.string() + " holds no point");
  return scan;
}

Result<void> write_cloud(const fs::path& path, const LidarScan& scan) {
  return replace_file(path,
                      {reinterpret_cast<const char*>(scan.points.data()), scan.points.size() * sizeof(LidarPoint)});
}

}  // namespace calib
