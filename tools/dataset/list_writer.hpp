#pragma once

#include <filesystem>
#include <vector>

#include "calib/camera.hpp"
#include "calib/frame.hpp"
#include "calib/geometry.hpp"
#include "calib/result.hpp"

namespace calib {

/// Writes a recording that `open_list` reads, with the true depth beside it: `recording.yaml` at `create`, then
/// `images/NAME.png`, `clouds/NAME.bin` and `depth/NAME.png` (kind `range`) per `append`. Fails with `write_failed`.
class ListWriter {
 public:
  /// Folders are made, files of the same name replaced.
  [[nodiscard]] static Result<ListWriter> create(const std::filesystem::path& folder, const Camera& camera,
                                                 const RigidTransform& T_camera_lidar);
  /// `range_m`: distance along the ray of every pixel of `image`, infinite where there is none; empty: no depth
  /// is known, and none written.
  [[nodiscard]] Result<void> append(const Image& image, const LidarScan& scan, const std::vector<float>& range_m);

 private:
  explicit ListWriter(std::filesystem::path folder) : folder_(std::move(folder)) {}
  std::filesystem::path folder_;
  std::size_t count_ = 0;
};

}  // namespace calib
