#include "calib/config_transform.hpp"

#include <algorithm>

namespace calib {
namespace {

std::array<double, 3> read_translation(const ConfigNode& node) {
  const auto t = node.at("translation_m").numbers(3, -max_translation_m, max_translation_m);
  return {t[0], t[1], t[2]};
}

/// The entries of a 3x4 or 4x4 matrix, row by row.
std::vector<double> read_entries(const ConfigNode& node) {
  const auto items = node.items();
  if (items.size() == 12 || items.size() == 16)
    return node.numbers(items.size(), -max_translation_m, max_translation_m);
  if (items.size() != 3 && items.size() != 4)
    node.refuse("needs 3 or 4 rows of 4 numbers, or 12 or 16 numbers row by row");
  std::vector<double> entries;
  for (const ConfigNode& row : items)
    std::ranges::copy(row.numbers(4, -max_translation_m, max_translation_m), std::back_inserter(entries));
  return entries;
}

}  // namespace

RigidTransform read_matrix(const ConfigNode& node) {
  const auto entries = read_entries(node);
  constexpr std::array last_row{0.0, 0.0, 0.0, 1.0};
  if (entries.size() == 16 && !std::equal(last_row.begin(), last_row.end(), entries.begin() + 12))
    node.refuse("needs 0, 0, 0, 1 as its last row; a matrix that stands the other way round must be transposed");
  Eigen::Matrix3d R;
  for (int i = 0; i < 9; ++i) R(i / 3, i % 3) = entries[static_cast<std::size_t>(i / 3 * 4 + i % 3)];
  const auto transform = transform_from_matrix({entries[3], entries[7], entries[11]}, R);
  if (!transform) node.refuse(transform.error().context);
  return *transform;
}

RigidTransform read_transform(const ConfigNode& node) {
  node.with_keys({"translation_m", "quaternion_xyzw", "rpy_deg", "matrix"});
  const auto matrix = node.find("matrix"), rpy = node.find("rpy_deg"), quaternion = node.find("quaternion_xyzw");
  if ((matrix && (rpy || quaternion || node.find("translation_m"))) || (rpy && quaternion))
    node.refuse("holds two forms of a transform; keep matrix, or translation_m with quaternion_xyzw or with rpy_deg");
  if (matrix) return read_matrix(*matrix);
  const auto t = read_translation(node);
  if (rpy) {
    const auto angles = rpy->numbers(3, -360, 360);
    RigidTransform transform = RigidTransform::Identity();
    transform.linear() = rotation_from_rpy(Eigen::Vector3d(angles.data()) * radians_per_degree);
    transform.translation() = Eigen::Vector3d(t.data());
    return transform;
  }
  const ConfigNode xyzw = node.at("quaternion_xyzw");
  const auto q = xyzw.numbers(4, -2, 2);
  const auto transform = make_transform(t, {q[0], q[1], q[2], q[3]});
  if (!transform) xyzw.refuse(transform.error().context);
  return *transform;
}

}  // namespace calib
