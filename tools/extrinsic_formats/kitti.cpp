#include <Eigen/LU>
#include <algorithm>

#include "extrinsic_formats/format_files.hpp"

namespace calib::formats {
namespace {

constexpr const char* camera0 = "camera0";
constexpr const char* velodyne = "velodyne";

using Values = std::map<std::string, std::vector<double>, std::less<>>;

/// Lines `KEY: numbers`. A value that is not all numbers, such as a date, is left out.
Values values_of(const TextFile& file) {
  Values values;
  for (std::size_t at = 0; at < file.text.size();) {
    const std::size_t end = std::min(file.text.find('\n', at), file.text.size());
    const std::string line = file.text.substr(at, end - at);
    at = end + 1;
    const auto colon = line.find(':');
    if (colon == std::string::npos) continue;
    std::vector<double> numbers;
    bool all = true;
    for (const std::string& word : words_of(line.substr(colon + 1))) {
      const auto number = parse_number(word);
      all = all && number;
      numbers.push_back(number.value_or(0));
    }
    if (all) values.emplace(line.substr(0, colon), numbers);
  }
  return values;
}

Result<std::vector<double>> numbers_of(const TextFile& file, const Values& values, std::string_view key,
                                       std::size_t count) {
  const auto found = values.find(key);
  if (found == values.end()) return malformed(file, std::string(key) + ": missing, or not all numbers");
  if (found->second.size() != count)
    return malformed(file, std::string(key) + ": has " + std::to_string(found->second.size()) + " numbers and needs " +
                               std::to_string(count));
  for (const double value : found->second)
    if (std::abs(value) > max_step_m) return malformed(file, std::string(key) + ": a number is beyond 1e7");
  return found->second;
}

Eigen::Matrix3d matrix3(const std::vector<double>& entries) {
  return Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(entries.data());
}

Result<RigidTransform> rigid(const TextFile& file, std::string_view key, const Eigen::Matrix3d& R,
                             const Eigen::Vector3d& t) {
  const auto T = transform_from_matrix({t.x(), t.y(), t.z()}, R);
  if (!T) return malformed(file, std::string(key) + ": " + T.error().context);
  return T;
}

/// Rectified camera N: x = P_rect_N R_rect_00 p = K (R_rect_00 p + K^-1 p4), p in camera 0 before rectification.
Result<void> add_rectified(const TextFile& file, const Values& values, int cameras, Frames& frames) {
  const auto R = numbers_of(file, values, "R_rect_00", 9);
  if (!R) return propagate(R);
  for (int camera = 0; camera < cameras; ++camera) {
    const std::string key = "P_rect_0" + std::to_string(camera);
    if (camera > 0 && !values.contains(key)) continue;
    const auto entries = numbers_of(file, values, key, 12);
    if (!entries) return propagate(entries);
    const Eigen::Matrix<double, 3, 4> P =
        Eigen::Map<const Eigen::Matrix<double, 3, 4, Eigen::RowMajor>>(entries->data());
    const Eigen::Vector3d t = P.leftCols<3>().inverse() * P.col(3);
    if (!t.allFinite()) return malformed(file, key + ": its left three columns are singular");
    const auto T = rigid(file, "R_rect_00", matrix3(*R), t);
    if (!T) return propagate(T);
    frames.edges.push_back({"rectified" + std::to_string(camera), camera0, *T, file.name});
  }
  return {};
}

Frames empty_frames() {
  return {.edges = {},
          .camera = camera0,
          .lidar = velodyne,
          .remark = "; rectified0, rectified2, ... need the file with R_rect_00 and P_rect_0N beside it"};
}

}  // namespace

Result<Frames> read_kitti(const std::vector<TextFile>& files) {
  Frames frames = empty_frames();
  for (const TextFile& file : files) {
    const Values values = values_of(file);
    if (values.contains("R_rect_00")) {
      if (const auto added = add_rectified(file, values, 4, frames); !added) return propagate(added);
      continue;
    }
    const auto R = numbers_of(file, values, "R", 9);
    if (!R) return propagate(R);
    const auto t = numbers_of(file, values, "T", 3);
    if (!t) return propagate(t);
    const auto T = rigid(file, "R", matrix3(*R), Eigen::Vector3d(t->data()));
    if (!T) return propagate(T);
    frames.edges.push_back({camera0, velodyne, *T, file.name});
  }
  return frames;
}

Result<Frames> read_kitti360(const std::vector<TextFile>& files) {
  Frames frames = empty_frames();
  for (const TextFile& file : files) {
    if (file.text.find(':') != std::string::npos) {
      // Cameras other than the left perspective one have poses of their own in calib_cam_to_pose.txt.
      if (const auto added = add_rectified(file, values_of(file), 1, frames); !added) return propagate(added);
      continue;
    }
    std::string line = file.text;
    std::ranges::replace(line, '\n', ' ');
    const Values values = values_of({file.name, "matrix:" + line});
    const auto M = numbers_of(file, values, "matrix", 12);
    if (!M) return propagate(M);
    const auto& m = *M;
    const auto T =
        rigid(file, "matrix", matrix3({m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]}), {m[3], m[7], m[11]});
    if (!T) return propagate(T);
    frames.edges.push_back({velodyne, camera0, *T, file.name});
  }
  return frames;
}

std::string kitti_text(const RigidTransform& T) {
  std::string R = "R:", t = "T:";
  for (int i = 0; i < 9; ++i) R += ' ' + number_text(T(i / 3, i % 3));
  for (int i = 0; i < 3; ++i) t += ' ' + number_text(T(i, 3));
  return R + '\n' + t + '\n';
}

std::string kitti360_text(const RigidTransform& T) {
  std::string line;
  for (int i = 0; i < 12; ++i) line += (i == 0 ? "" : " ") + number_text(T(i / 4, i % 4));
  return line + '\n';
}

}  // namespace calib::formats
