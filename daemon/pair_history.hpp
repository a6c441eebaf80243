#pragma once

#include <cstdint>
#include <optional>
#include <set>
#include <vector>

#include "calib/record.hpp"

namespace calib {

/// Whether two extrinsics differ by no more than rounding.
[[nodiscard]] bool same(const RigidTransform& a, const RigidTransform& b);

/// What the signed records say of one pair: each was verified when the ledger was opened, or signed by this process.
struct PairHistory {
  std::vector<CalibrationRecord> extrinsics;  // that came into force, oldest first
  std::vector<CalibrationRecord> baselines;   // oldest first
  std::optional<CalibrationRecord> initial;   // the last one: the configuration as it was last taken over

  /// Records that somebody else may have signed: of a key that was revoked.
  std::set<std::uint64_t> doubted;

  void add(CalibrationRecord record);
  /// Doubts the records of these numbers, `until` excluded; baselines among them are forgotten.
  void doubt(std::uint64_t from, std::uint64_t until);
  /// Forgets what was never signed.
  void forget_unsigned();

  /// Nothing before the pair's first record. Of number 0 where it could not be signed, while signing is refused.
  [[nodiscard]] const CalibrationRecord* in_force() const;
  /// The one that was in force before the present one, if any.
  [[nodiscard]] const CalibrationRecord* before_in_force() const;
  /// The last baseline of an extrinsic, or of the one in force; also one from an earlier time in which it was in force.
  [[nodiscard]] const CalibrationRecord* baseline(const RigidTransform& T_camera_lidar) const;
  [[nodiscard]] const CalibrationRecord* baseline() const;
  /// The baseline that counts: of the extrinsic in force, measured with what `evidence_sha256` is the digest of, and
  /// learned since that extrinsic came into force; at any time before, where it was rolled back to.
  [[nodiscard]] const CalibrationRecord* known_baseline(const std::string& evidence_sha256) const;
  /// Whether the extrinsic in force has passed its probation: its baseline is signed at the end of that.
  [[nodiscard]] bool probation_passed() const;
};

}  // namespace calib
