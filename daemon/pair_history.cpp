#include "pair_history.hpp"

#include <algorithm>

namespace calib {

bool same(const RigidTransform& a, const RigidTransform& b) {
  const RigidTransform difference = a.inverse() * b;
  return rotation_angle_rad(difference) < 1e-9 && difference.translation().norm() < 1e-9;
}

void PairHistory::add(CalibrationRecord record) {
  if (record.decision == Decision::initial) initial = record;
  if (record.decision == Decision::baseline) baselines.push_back(record);
  if (puts_in_force(record.decision)) extrinsics.push_back(std::move(record));
}

void PairHistory::doubt(std::uint64_t from, std::uint64_t until) {
  const auto in_doubt = [&](const CalibrationRecord& record) {
    return from <= record.sequence && record.sequence < until;
  };
  std::erase_if(baselines, in_doubt);
  for (const CalibrationRecord& record : extrinsics)
    if (in_doubt(record)) doubted.insert(record.sequence);
}

void PairHistory::forget_unsigned() {
  std::erase_if(extrinsics, [](const CalibrationRecord& record) { return record.sequence == 0; });
}

const CalibrationRecord* PairHistory::in_force() const { return extrinsics.empty() ? nullptr : &extrinsics.back(); }

const CalibrationRecord* PairHistory::before_in_force() const {
  return extrinsics.size() < 2 ? nullptr : &extrinsics[extrinsics.size() - 2];
}

const CalibrationRecord* PairHistory::baseline(const RigidTransform& T_camera_lidar) const {
  const auto found = std::find_if(baselines.rbegin(), baselines.rend(), [&](const CalibrationRecord& record) {
    return same(record.T_camera_lidar, T_camera_lidar);
  });
  return found == baselines.rend() ? nullptr : &*found;
}

const CalibrationRecord* PairHistory::baseline() const {
  return extrinsics.empty() ? nullptr : baseline(extrinsics.back().T_camera_lidar);
}

const CalibrationRecord* PairHistory::known_baseline(const std::string& evidence_sha256) const {
  const CalibrationRecord* known = baseline();
  if (known == nullptr || in_force()->sequence == 0 || known->evidence_sha256 != evidence_sha256) return nullptr;
  return known->sequence > in_force()->sequence || in_force()->decision == Decision::rolled_back ? known : nullptr;
}

bool PairHistory::probation_passed() const {
  const CalibrationRecord* learned = baseline();
  return in_force()->decision != Decision::accepted || (learned != nullptr && learned->sequence > in_force()->sequence);
}

}  // namespace calib
