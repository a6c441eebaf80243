#include <array>
#include <cmath>
#include <opencv2/imgcodecs.hpp>

#include "dataset/depth_files.hpp"
#include "fuzz/fuzz.hpp"
#include "fuzz/scratch.hpp"

namespace calib::fuzz {

constexpr int side = 16;
constexpr std::array extensions{".npy", ".png", ".tif", ".pfm"};
constexpr std::array depth_kinds{DepthKind::disparity, DepthKind::inverse, DepthKind::depth, DepthKind::range};

Octets npy(char version) {
  std::string header = "{'descr': '<f4', 'fortran_order': False, 'shape': (16, 16), }";
  header.resize(version == 1 ? 117 : 115, ' ');
  header += '\n';
  std::string file = "\x93NUMPY";
  file += {version, '\0', static_cast<char>(header.size()), '\0'};
  if (version != 1) file += std::string(2, '\0');
  file += header;
  for (int i = 0; i < side * side; ++i) file += std::string("\0\0\x80\x3f", 4);  // 1.0
  return octets(file);
}

std::vector<Octets> seeds() {
  std::vector<Octets> all;
  const auto add = [&](std::uint8_t extension, const Octets& file) {
    all.push_back(Output().put(extension).put(static_cast<std::uint8_t>(all.size())).with(file));
  };
  add(0, npy(1));
  add(0, npy(2));
  Octets image;
  require(cv::imencode(".png", cv::Mat(side, side, CV_16UC1, cv::Scalar(512)), image));
  add(1, image);
  require(cv::imencode(".tif", cv::Mat(side, side, CV_16UC1, cv::Scalar(512)), image));
  add(2, image);
  require(cv::imencode(".tif", cv::Mat(side, side, CV_32FC1, cv::Scalar(2)), image));
  add(2, image);
  require(cv::imencode(".pfm", cv::Mat(side, side, CV_32FC1, cv::Scalar(2)), image));
  add(3, image);
  return all;
}

void check(const Result<DepthMap>& depth) {
  if (!depth) return require_code(depth.error(), {ErrorCode::depth_unreadable, ErrorCode::depth_empty});
  require(depth->width == side && depth->height == side && depth->inverse_depth.size() == side * side);
  for (const float inverse : depth->inverse_depth)
    require(inverse == DepthMap::no_depth || (inverse > 0 && std::isfinite(inverse)));
}

}  // namespace calib::fuzz

/// Which kind of file, which kind of depth, the file.
int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t size) {
  using namespace calib::fuzz;
  static const auto camera = calib::Camera::make(calib::CameraModel::rectified, side, side, {10, 10, 7.5, 7.5});
  require(camera.has_value());
  Input input(bytes, size);
  const std::string extension = extensions[input.take<std::uint8_t>() % extensions.size()];
  const auto kind = depth_kinds[input.take<std::uint8_t>() % depth_kinds.size()];
  const Octets file = input.rest();
  const auto path = scratch().write("frame" + extension, text(file));
  check(calib::read_depth({scratch().folder(), kind, std::nullopt}, "frame", *camera, 0.5));
  std::filesystem::remove(path);  // it would be found before one of another kind
  return 0;
}
